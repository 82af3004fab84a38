defmodule Phoenix.LiveView.JSTest do
  use ExUnit.Case, async: true

  alias Phoenix.LiveView.JS

  # Commands and their form on the wire, which the client defines.
  for {name, commands, wire} <- [
        {"push", quote(do: JS.push("go", value: %{a: 1}, target: "#x")),
         [["push", %{event: "go", value: %{a: 1}, target: "#x"}]]},
        {"chain", quote(do: "a" |> JS.push() |> JS.push("b")),
         [["push", %{event: "a"}], ["push", %{event: "b"}]]},
        {"dispatch", quote(do: JS.dispatch("x:y", to: "#a", detail: %{b: 2}, bubbles: false)),
         [["dispatch", %{event: "x:y", to: "#a", detail: %{b: 2}, bubbles: false}]]},
        {"show", quote(do: JS.show(to: "#a", display: "flex", time: 10)),
         [["show", %{to: "#a", display: "flex", time: 10}]]},
        {"hide", quote(do: JS.hide(%JS{}, transition: {"t", "from x", "to"})),
         [["hide", %{transition: [["t"], ["from", "x"], ["to"]]}]]},
        {"toggle", quote(do: JS.toggle(to: {:inner, ".b"}, in: "fade")),
         [["toggle", %{to: %{inner: ".b"}, ins: [["fade"], [], []]}]]},
        {"add_class", quote(do: JS.add_class("a b", to: {:closest, "li"})),
         [["add_class", %{names: ["a", "b"], to: %{closest: "li"}}]]},
        {"remove_class", quote(do: JS.remove_class(%JS{}, "a")), [["remove_class", %{names: ["a"]}]]},
        {"toggle_class", quote(do: JS.toggle_class("a", to: {:document, "p"})),
         [["toggle_class", %{names: ["a"], to: "p"}]]},
        {"transition", quote(do: JS.transition("shake", time: 5)),
         [["transition", %{transition: [["shake"], [], []], time: 5}]]},
        {"set_attribute", quote(do: JS.set_attribute({"a", "b"}, to: "#x")),
         [["set_attr", %{attr: ["a", "b"], to: "#x"}]]},
        {"remove_attribute", quote(do: JS.remove_attribute("a", to: "#x")),
         [["remove_attr", %{attr: "a", to: "#x"}]]},
        {"toggle_attribute", quote(do: JS.toggle_attribute({"a", "b", "c"})),
         [["toggle_attr", %{attr: ["a", "b", "c"]}]]},
        {"focus", quote(do: JS.focus(to: "#x") |> JS.focus_first() |> JS.push_focus() |> JS.pop_focus()),
         [["focus", %{to: "#x"}], ["focus_first", %{}], ["push_focus", %{}], ["pop_focus", %{}]]},
        {"exec", quote(do: JS.exec("data-cancel", to: "#x")), [["exec", %{attr: "data-cancel", to: "#x"}]]},
        {"navigate", quote(do: JS.navigate("/a")), [["navigate", %{href: "/a", replace: false}]]},
        {"patch", quote(do: JS.patch(%JS{}, "/a", replace: true)), [["patch", %{href: "/a", replace: true}]]},
        {"ignore_attributes", quote(do: JS.ignore_attributes("open")),
         [["ignore_attrs", %{attrs: ["open"]}]]},
        {"concat", quote(do: JS.concat(JS.push("a"), JS.hide())), [["push", %{event: "a"}], ["hide", %{}]]}
      ] do
    test name do
      js = unquote(commands)
      assert JS.to_encodable(js) == unquote(Macro.escape(wire))

      assert js |> JSON.encode!() |> JSON.decode!() ==
               unquote(Macro.escape(wire)) |> JSON.encode!() |> JSON.decode!()
    end
  end

  test "in an attribute they are escaped JSON" do
    assert Phoenix.HTML.safe_to_string(Phoenix.HTML.html_escape(JS.push("a"))) ==
             "[[&quot;push&quot;,{&quot;event&quot;:&quot;a&quot;}]]"
  end

  for {name, commands} <- [
        {"an unknown option", quote(do: JS.show(odd: 1))},
        {"a value that is no map", quote(do: JS.push("a", value: 1))},
        {"details of a click", quote(do: JS.dispatch("click", detail: %{}))},
        {"details that are no map", quote(do: JS.dispatch("x", detail: 1))},
        {"the client's own key", quote(do: JS.dispatch("x", blocking: true, detail: %{done: 1}))},
        {"a scheme that runs code", quote(do: JS.navigate("javascript:alert(1)"))}
      ] do
    test "an error: #{name}" do
      assert_raise ArgumentError, fn -> unquote(commands) end
    end
  end
end
