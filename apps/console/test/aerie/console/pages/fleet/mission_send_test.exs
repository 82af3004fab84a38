defmodule Aerie.Console.Pages.Fleet.MissionSendTest do
  @moduledoc "The sheet that sends missions to several vehicles: nothing is sent before the press for what was shown."
  use Aerie.ConsoleCase, async: true

  import Aerie.ActCase, except: [put: 3, put: 4, value: 2]

  alias Aerie.Base.Store
  alias Aerie.Control.Missions
  alias Aerie.Fleet
  alias Protocols.Mission.{Item, Plan}

  @moduletag :tmp_dir
  @moduletag :capture_log

  setup %{tmp_dir: dir} do
    console = Aerie.ActCase.start(dir)
    Aerie.ShadowCase.start_shadow(console.gateway, dir)
    for n <- 1..3, do: put(console, n)
    {:ok, console: console}
  end

  # In the air, eleven metres from the next one.
  defp put(console, n, groups \\ [], fields \\ %{}) do
    groups =
      Keyword.merge(
        [
          mode: %{mode: "LOITER", armed: true, in_air: true},
          position: %{lat: 47.0 + n / 10_000, lon: 8.0, alt_rel: 20.0},
          home: %{lat: 47.0 + n / 10_000, lon: 8.0, alt_msl: 450.0}
        ],
        groups,
        fn _group, data, changes -> Map.merge(data, changes) end
      )

    Aerie.ActCase.put(console, n, groups, fields)
  end

  # From west to east, a hundred metres from the vehicles.
  defp plan(fields \\ []) do
    items =
      for n <- 0..2, do: %Item{command: 16, frame: 3, x: 470_010_000, y: 80_000_000 + n * 10_000, z: 30.0}

    struct!(%Plan{items: items}, fields)
  end

  defp file(name, plan \\ plan()) do
    {:ok, text} = Missions.export(plan, :plan)
    %{"name" => name, "text" => text}
  end

  defp open(console, role \\ :operator) do
    {:ok, view, _html} = live(conn(console, role), "/")
    render_click(view, "all")
    view
  end

  defp sheet(console) do
    view = open(console)
    view |> element("#fleet-actions button", "Mission to 3") |> render_click()
    view
  end

  defp files(view, files) do
    render_hook(view, "sheet_files", %{"files" => files})
    compared(view)
  end

  defp fields(view, fields) do
    view |> form("#mission-form", fields) |> render_change()
    compared(view)
  end

  # The fields of an offset are there once it is chosen.
  defp beside(view, east, north, up, more) do
    fields(view, %{how: "offset"})
    fields(view, Map.merge(%{east: east, north: north, up: up}, more))
  end

  # What takes longer is worked out beside the page.
  defp compared(view) do
    eventually(fn -> not (render(view) =~ "The plans are being compared.") end)
    view
  end

  defp line(view, id), do: view |> element("#mission-#{id}") |> render() |> String.replace(~r/\s+/, " ")
  defp button(view), do: view |> element("#mission-go") |> render()

  defp value(view), do: Aerie.ActCase.value(view, "#mission-go")
  defp agree(view), do: view |> element("#mission-agree") |> render_click()

  test "each has the plan a little beside the one before, and the press is one operation with a hash for each",
       %{
         console: console
       } do
    view = sheet(console)
    assert button(view) =~ "Choose a file, or the draft of the page Plan."
    files(view, [file("field.plan")])
    assert line(view, "V1") =~ "field.plan"
    assert line(view, "V1") =~ "3 items"
    beside(view, "0", "20", "4", %{interval: "0"})
    assert line(view, "V3") =~ ~r/\+40 m N, \+8 m up.*3 items.*to V2 at 00:/
    assert has_element?(view, ".sheet-summary", "Speed not known, 5 m/s assumed: V1, V2, V3.")
    refute has_element?(view, "#mission-agree")
    assert button(view) =~ "Send to 3\n"

    %{"vehicles" => [["V1", first, 3], ["V2", second, 3], ["V3", _third, 3]]} = value = value(view)
    assert first != second
    hold(view, value)
    refute has_element?(view, "#mission")
    hold(view, value)
    assert [%{"id" => "web-1", "name" => "Send missions"}] = operations(console)
    assert has_element?(view, "#operation-web-1", "Send missions 3")

    # What was sent is what was shown: moved by four metres, as it is stored under its hash.
    eventually(fn ->
      case Fleet.Shadow.get(console.gateway, "V2") do
        {:ok, %{"desired" => %{"mission" => %{"plan" => ^second}}}} -> true
        _not_yet -> false
      end
    end)

    # It goes on without its page, and a new page finds it.
    ref = Process.monitor(view.pid)
    Process.exit(view.pid, :kill)
    assert_receive {:DOWN, ^ref, :process, _pid, _killed}
    assert has_element?(open(console), "#operation-web-1", "sending")
  end

  test "those that come near to each other are sent only after a tick for just that", %{console: console} do
    view = console |> sheet() |> files([file("field.plan")])
    fields(view, %{interval: "0"})
    assert has_element?(view, ".mission-agree", "Nearest 0.0 m at")
    assert line(view, "V1") =~ ~s(badge bad)
    assert button(view) =~ "Somebody has to agree"
    untouched = value(view)
    assert hold(view, untouched) =~ "Nothing was sent: Somebody has to agree"

    # A tick for something else does not count.
    render_hook(view, "sheet_agree", %{"agreed" => "abc"})
    assert button(view) =~ "Somebody has to agree"
    agree(view)
    refute button(view) =~ "Somebody has to agree"
    beside(view, "0", "1", "0", %{interval: "0"})
    assert button(view) =~ "Somebody has to agree"
    assert hold(view, untouched) =~ "What was shown has changed"
    assert operations(console) == []
    agree(view)
    hold(view, value(view))
    assert [%{"id" => "web-1"}] = operations(console)
  end

  test "a plan that leaves the fence of its file wants the tick", %{console: console} do
    fence = [{:inclusion, {:circle, {470_010_000, 80_000_000}, 30.0}}]
    view = console |> sheet() |> files([file("field.plan", plan(fence: fence))])
    for id <- ~w(V2 V3), do: view |> element("#mission-#{id} button", "Leave out") |> render_click()
    compared(view)
    assert has_element?(view, ".mission-agree", "V1: item 2 is outside")
    assert button(view) =~ "Somebody has to agree"
  end

  test "a file for each by its name or tag, and what is missing or too much is named", %{console: console} do
    :ok = Fleet.Shadow.tag(console.gateway, "V2", ["north"])
    view = sheet(console)
    names = ["V1.plan", "north.plan", "other.plan"]
    files(view, for(name <- names, do: file(name)))
    assert button(view) =~ "there are 3 files: keep one"
    fields(view, %{how: "name"})
    assert line(view, "V2") =~ "north.plan"
    assert button(view) =~ "V3: no file&#39;s name has V3 or a tag of it"
    assert has_element?(view, ".sheet-summary", "other.plan names none of these vehicles, by id or tag.")
    view |> element("#mission-V3 button", "Leave out") |> render_click()
    view |> element("#mission-files button[aria-label='Remove other.plan']") |> render_click()
    compared(view)
    refute has_element?(view, ".sheet-summary", "other.plan")
    assert [["V1", _one, 3], ["V2", _two, 3]] = value(view)["vehicles"]
  end

  test "files that cannot be read, are too many or have no mission change nothing", %{console: console} do
    view = sheet(console)

    assert render_hook(view, "sheet_files", %{"files" => [%{"name" => "x.plan", "text" => "{}"}]}) =~
             "x.plan: "

    for odd <- [%{}, %{"files" => 7}, %{"files" => [7, %{"name" => 1, "text" => 2}]}],
        do: render_hook(view, "sheet_files", odd)

    assert render_hook(view, "sheet_files", %{"error" => "This tab has no draft"}) =~ "This tab has no draft"
    assert button(view) =~ "Choose a file"

    files(view, [file("fence.plan", %Plan{fence: [{:inclusion, {:circle, {470_000_000, 80_000_000}, 30.0}}]})])

    assert button(view) =~ "fence.plan has no mission"
    many = for n <- 1..99, do: file("#{n}.plan")
    render_hook(view, "sheet_files", %{"files" => many})
    assert render_hook(view, "sheet_files", %{"files" => [file("last.plan")]}) =~ "At most 100 files."
    assert operations(console) == []
  end

  test "one that has no missions, is in somebody's charge, flies its mission, or is denied it, is named", %{
    console: console
  } do
    put(console, 1, [], %{autopilot: :betaflight})
    view = console |> sheet() |> files([file("field.plan")])
    assert button(view) =~ "V1: Betaflight has no missions"
    view |> element("#mission-V1 button", "Leave out") |> render_click()

    take_charge(console, 2, "olga")

    refresh_fleet(view)
    compared(view)
    assert button(view) =~ "V2: it is in the charge of olga"
    view |> element("#mission-V2 button", "Leave out") |> render_click()
    put(console, 3, mode: %{mode: "AUTO"})
    refresh_fleet(view)
    compared(view)
    assert button(view) =~ "V3: it flies its mission"
    put(console, 3)
    :ok = Aerie.Control.Policy.Store.put(console.gateway, %{max_altitude: 22.0})
    view |> element("#mission-V2 button", "Take along") |> render_click()
    view |> element("#mission-V2 button", "Leave out") |> render_click()
    fields(view, %{interval: "1"})
    assert button(view) =~ "V3: item 1: "
    assert operations(console) == []
  end

  test "one that lands while the button is held is not what was shown", %{console: console} do
    view = console |> sheet() |> files([file("field.plan")])
    beside(view, "0", "20", "4", %{interval: "0"})
    shown = value(view)
    put(console, 2, mode: %{armed: false, in_air: false})
    assert hold(view, shown) =~ "What was shown has changed"
    compared(view)
    assert has_element?(view, "#mission-V2", "its way to the first place is not compared")
    :ok = Store.delete_vehicle(console.gateway, {"main", 3})
    refresh_fleet(view)
    compared(view)
    assert hold(view, shown) =~ "What was shown has changed"
    assert operations(console) == []
  end

  test "a second operator's operation on the same vehicles is refused while the first one runs", %{
    console: console
  } do
    [one, two] =
      for _operator <- 1..2 do
        view = console |> sheet() |> files([file("field.plan")])
        beside(view, "0", "20", "4", %{interval: "0"})
      end

    hold(one, value(one))
    assert hold(two, value(two), "web-2") =~ "V1 is part of the operation web-1, which runs"
    assert [%{"id" => "web-1"}] = operations(console)
  end

  test "sixty vehicles are one sheet and one operation", %{
    console: console
  } do
    for n <- 4..60, do: put(console, n)
    view = open(console)
    view |> element("#fleet-actions button", "Mission to 60") |> render_click()
    files(view, [file("field.plan")])
    beside(view, "0", "20", "4", %{interval: "0"})
    assert line(view, "V9") =~ "m N, "
    hold(view, value(view))
    assert [%{"id" => "web-1", "counts" => counts}] = operations(console)
    assert counts |> Map.values() |> Enum.sum() == 60
  end

  test "a viewer has neither the button nor the events", %{console: console} do
    view = open(console, :viewer)
    refute has_element?(view, "#fleet-actions button", "Mission to")
    press = %{"ids" => ~w(V1 V2 V3), "of" => ~w(V1 V2 V3), "files" => [file("field.plan")]}
    for event <- ~w(sheet_mission sheet_files sheet_agree sheet_go), do: render_hook(view, event, press)
    refute has_element?(view, "#mission")
    assert operations(console) == []
  end

  @tag :chromium
  test "by mouse and keyboard: files, a tick, one that lands under the hand, a killed page, a draft", %{
    console: console,
    tmp_dir: dir
  } do
    put(console, 4, [], %{autopilot: :betaflight})
    path = Path.join(dir, "field.plan")
    File.write!(path, file("field.plan")["text"])
    script = browser(console, "mission_send.mjs", [path])
    await_line(script, "holding")
    put(console, 3, mode: %{armed: false, in_air: false})
    Port.command(script, "landed\n")
    await_line(script, "ended")
    assert operations(console) == []
    Port.command(script, "begin\n")
    await_line(script, "begun")
    assert [%{"state" => "running", "name" => "Send missions"}] = operations(console)
    kill_pages(console)
    Port.command(script, "killed\n")
    await_line(script, "back")
    Port.command(script, "done\n")
    await_line(script, "ok")
    assert [%{"counts" => %{"under_way" => 2}}] = operations(console)
  end
end
