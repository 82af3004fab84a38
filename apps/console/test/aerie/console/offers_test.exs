defmodule Aerie.Console.OffersTest do
  @moduledoc "No page offers a user what it then refuses for the user's role."
  use Aerie.VehiclePageCase, async: true

  alias Aerie.Control.Policy.Roles
  alias Aerie.Fleet.Alarms
  alias Aerie.Console.Pages

  # What hooks send: the name of the event is in the element.
  @attributes ~w(phx-click phx-submit phx-change data-event)

  setup %{console: console} do
    put_link(console, "radio", %{sources: %{{7, 1} => %{received: 95, lost: 5}}})
    put(console, mode: %{armed: false, in_air: false}, mission: %{seq: 1, total: 3})
    put_vehicle(console, "VID-009", [], %{status: :lost})
    eventually(fn -> Alarms.summary(console.gateway).first != nil end)
    :ok
  end

  for role <- [:viewer, :operator, :admin] do
    test "as #{role}", %{console: console} do
      offers =
        for {path, page} <- routes(),
            Roles.at_least?(unquote(role), page.__console__().role),
            event <- offered(console, unquote(role), path),
            do: {path, event, Map.get(page.__console__().events, event, :operator)}

      assert {"/", "filter", :viewer} in offers
      assert Enum.reject(offers, fn {_path, _event, least} -> Roles.at_least?(unquote(role), least) end) == []
    end
  end

  test "a viewer sees alarms and acknowledges none", %{console: console} do
    view = open(console, :viewer, "/")
    assert has_element?(view, "#alarm-strip .alarm-text", "Lost contact")
    refute has_element?(view, "#alarm-strip button", "Acknowledge")
    assert open(console, :operator, "/") |> has_element?("#alarm-strip button", "Acknowledge")
    refute open(console, :viewer, "/alarms") |> has_element?("button", "Acknowledge")
  end

  defp offered(console, role, path) do
    {:ok, view, html} = live(conn(console, role), path)
    Enum.uniq(events(html) ++ events(render(view)))
  end

  # The parameters of a path are vehicles, and the parts of their pages.
  defp routes do
    for %{path: path, page: page} <- Pages.all(),
        path <- paths(String.replace(path, ":id", "VID-007")),
        do: {path, page}
  end

  defp paths(path) do
    if String.contains?(path, ":section"),
      do:
        for(
          part <- ~w(commands?c=land commands?c=reboot commands events charts health links),
          do: String.replace(path, ":section", part)
        ),
      else: [path] ++ if(path in ["/plan", "/params"], do: [path <> "?vehicle=VID-007"], else: [])
  end

  defp events(html) do
    for name <- @attributes,
        [_all, value] <- Regex.scan(~r/#{name}="([^"]*)"/, html),
        event <- named(String.replace(value, "&quot;", "\"")),
        do: event
  end

  defp named("[" <> _rest = commands),
    do: for(["push", %{"event" => event}] <- JSON.decode!(commands), do: event)

  defp named(event), do: [event]
end
