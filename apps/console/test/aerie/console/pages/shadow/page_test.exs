defmodule Aerie.Console.Pages.Shadow.PageTest do
  @moduledoc "The page of a shadow; the test is the vehicle's executor."
  use Aerie.ConsoleCase, async: true

  import Aerie.CommandCase, only: [start_commands: 2, answer: 3, executing: 1]
  import Aerie.ShadowCase, only: [start_shadow: 3, start_loop: 1, standing: 3]

  alias Aerie.Fleet.Shadow
  alias Aerie.Console.Pages.Shadow.{Input, Rows}

  @moduletag :tmp_dir
  @moduletag :capture_log
  @id "VID-007"
  @path "/vehicles/VID-007/shadow"

  setup %{tmp_dir: dir} do
    [console: console] = start_console()
    start_commands(dir, gateway: console.gateway)
    Aerie.CommandCase.put_vehicle(console.gateway, %{in_air: true})
    # The vehicle is armed: the shadow would stay away for as long.
    start_shadow(console.gateway, dir, [{"shadow.hold_s", 0.1}])
    start_loop(console.gateway)
    %{console: console}
  end

  defp open(console, role \\ :admin) do
    {:ok, view, _html} = live(conn(console, role), @path)
    view
  end

  defp shown?(view, selector, text) do
    send(view.pid, :refresh)
    has_element?(view, selector, text)
  end

  defp desire(view, fields) do
    view |> form("#desire", Map.take(fields, [:field])) |> render_change()
    assert has_element?(view, "#desire #desire-set.hold")
    refute has_element?(view, "#desire [type=submit]")
    view |> form("#desire", fields) |> render_change()
    [_all, version] = Regex.run(~r/name="version" value="(\d+)"/, view |> element("#desire") |> render())
    fields = Map.new(fields, fn {name, value} -> {to_string(name), value} end)
    render_hook(view, "desire", %{"id" => "d1", "fields" => Map.put(fields, "version", version)})
  end

  test "what is desired, how it stands, who set it, until it agrees; then it is removed", %{console: console} do
    view = open(console)
    assert render(view) =~ "No desired state"
    desire(view, %{field: "mode", value: "LOITER", reason: "storm", expires: "3600"})
    from = executing(%{type: "set_mode", source: "shadow", id: id})
    eventually(fn -> shown?(view, "#field-mode", "pending") end)
    assert has_element?(view, "#field-mode", "admin (console)")
    assert has_element?(view, "#field-mode", "storm")
    assert has_element?(view, "#field-mode", "ends 20")
    assert has_element?(view, "#change-1", "mode")

    # The vehicle shows it first: a mode that is late would be asked for again.
    Aerie.CommandCase.put_vehicle(console.gateway, %{in_air: true, mode: "LOITER"})
    answer(from, id, :accepted)
    standing(console.gateway, "mode", :converged)
    eventually(fn -> shown?(view, "#field-mode", "converged") end)

    view |> element("#field-mode button.icon-only") |> render_click()
    eventually(fn -> not shown?(view, "#field-mode", "LOITER") end)
    assert has_element?(view, "#change-2", "removed")
  end

  test "what cannot be is refused with the reason, and nothing changes", %{console: console} do
    view = open(console)
    assert desire(view, %{field: "params.*", name: "", value: "1"}) =~ "needs the name of a parameter"
    assert desire(view, %{field: "params.*", name: "RTL_ALT", value: "high"}) =~ "expected a number"
    assert desire(view, %{field: "home", value: "47.1"}) =~ "desired.home"
    assert desire(view, %{field: "mission.plan", value: "abc"}) =~ "64 hexadecimal digits"

    assert render_hook(view, "desire", %{"fields" => %{"field" => "__proto__", "version" => "0"}}) =~
             "is not a field"

    assert {:ok, %{"version" => 0}} = Shadow.get(console.gateway, @id)
  end

  test "fields are offered by permission, and a viewer only looks on", %{console: console} do
    view = open(console, :operator)
    assert has_element?(view, "#desire-field option", "mode")
    refute has_element?(view, "#desire-field option", "params.*")
    {:ok, _} = Shadow.update(console.gateway, @id, %{"desired" => %{"params" => %{"RTL_ALT" => 80}}})
    eventually(fn -> shown?(view, "[id='field-params.RTL_ALT']", "80") end)
    refute has_element?(view, "[id='field-params.RTL_ALT'] button")

    form = %{"field" => "params.*", "name" => "RTL_ALT", "value" => "1", "version" => "1"}
    assert render_hook(view, "desire", %{"fields" => form}) =~ "maintain"
    # A press on what was shown before that change.
    mode = %{"field" => "mode", "value" => "LOITER"}

    for earlier <- ["0", "x"],
        do: assert(render_hook(view, "desire", %{"fields" => Map.put(mode, "version", earlier)}) =~ "version")

    assert {:ok, %{"version" => 1}} = Shadow.get(console.gateway, @id)

    viewer = open(console, :viewer)
    refute has_element?(viewer, "#desire")
    assert render_click(viewer, "remove_all") =~ "Viewers can&#39;t do this"

    admin = open(console)
    admin |> element("button", "Remove all") |> render_click()
    admin |> element("#remove-all button.danger") |> render_click()
    assert {:ok, %{"desired" => desired}} = Shadow.get(console.gateway, @id)
    assert desired == %{}
  end

  test "a vehicle that nobody has heard of", %{console: console} do
    {:ok, view, _html} = live(conn(console, :admin), "/vehicles/VID-999/shadow")
    assert render(view) =~ "No desired state"
    desire(view, %{field: "tags", value: "later"})
    assert Shadow.tags(console.gateway)["VID-999"] == ["later"]
  end

  test "values as text, and back" do
    for {path, value} <- [
          {"tags", ["a", "b"]},
          {"recorder", true},
          {"geofence.enabled", false},
          {"home", %{"lat" => 47.1, "lon" => 8, "altitude_msl" => 500}},
          {"params.RTL_ALT", 80},
          {"intervals.ATTITUDE", 2.5},
          {"mode", "LOITER"}
        ] do
      assert {:ok, %{"desired" => desired}} = path |> Input.form(Rows.text(value)) |> Input.request(3)
      assert Rows.at(desired, path) == value
      # It is for the version that was shown; the shadow refuses it for another one.
      assert {:ok, %{"version" => 3}} = path |> Input.form("1") |> Input.request(3)
    end
  end
end
