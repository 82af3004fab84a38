defmodule Phoenix.LiveView.JSTest do
  use ExUnit.Case, async: true

  alias Phoenix.LiveView.JS

  # Commands and their form on the wire, which the client defines.
  for {name, commands, wire} <- [
        {"push", quote(do: JS.push("go", value: %{a: 1})),
         [["push", %{"event" => "go", "value" => %{"a" => 1}}]]},
        {"chain", quote(do: "a" |> JS.push() |> JS.push("b")),
         [["push", %{"event" => "a"}], ["push", %{"event" => "b"}]]},
        {"ignore_attributes", quote(do: JS.ignore_attributes("open")),
         [["ignore_attrs", %{"attrs" => ["open"]}]]},
        {"several attributes", quote(do: JS.ignore_attributes(~w(a data-*))),
         [["ignore_attrs", %{"attrs" => ["a", "data-*"]}]]}
      ] do
    test name do
      {:safe, text} = Phoenix.HTML.html_escape(unquote(commands))
      json = text |> IO.iodata_to_binary() |> String.replace("&quot;", "\"")
      assert JSON.decode!(json) == unquote(Macro.escape(wire))
    end
  end
end
