defmodule Aerie.Console.Pages.Fleet.SlowLineTest do
  @moduledoc "The console under an operator's hand, in a browser that the gateway's answers reach late."
  use Aerie.ConsoleCase, async: true

  alias Aerie.Control.Commands
  alias Aerie.Base.Store
  alias Aerie.SlowLine

  @moduletag :chromium
  @moduletag :tmp_dir
  @delay_ms 1_400

  setup %{tmp_dir: dir} do
    [console: console] = start_console()
    Aerie.CommandCase.start_commands(dir, gateway: console.gateway)
    start_operations(console)
    :ok = Store.delete_vehicle(console.gateway, {"main", 7})
    put_link(console, "radio")
    for n <- 1..4, do: vehicle(console, n, 0.5 + n / 100)
    line = start_supervised!({SlowLine, port: console.port})
    {:ok, console: console, proxy: line, slow: %{console | url: SlowLine.url(line)}}
  end

  defp vehicle(console, n, left, groups \\ []) do
    groups = Keyword.merge([battery: %{remaining: left}], groups)
    memory = %{sources: %{}, mode_names: %{}}
    put_vehicle(console, "V#{n}", groups, %{key: {"main", n}, system_id: n, component: 1, memory: memory})
  end

  defp commanded(console),
    do: for(n <- 1..4, %{type: type} <- Commands.recent(console.gateway, "V#{n}", 20), do: {"V#{n}", type})

  defp tell(script, word), do: Port.command(script, word <> "\n")

  test "a press is for the vehicles that are shown, and ends when others are selected", c do
    script = browser(c.slow, "hand.mjs", ["press"])
    await_line(script, "ready")
    :ok = SlowLine.delay(c.proxy, @delay_ms)
    tell(script, "slow")
    await_line(script, "refused")
    assert commanded(c.console) == []
    :ok = SlowLine.delay(c.proxy, 0)
    tell(script, "quick")
    await_line(script, "ended")
    assert commanded(c.console) == []
    tell(script, "go on")
    await_line(script, "ok")
    assert Enum.uniq(commanded(c.console)) == [{"V3", "rtl"}]
  end

  test "rows keep their places under the pointer, and what appears moves none", c do
    script = browser(c.slow, "hand.mjs", ["rows"])
    await_line(script, "away")
    :ok = SlowLine.delay(c.proxy, @delay_ms)
    vehicle(c.console, 1, 0.9)
    vehicle(c.console, 5, 0.1)
    tell(script, "sorted")
    await_line(script, "held")
    :ok = SlowLine.delay(c.proxy, 0)
    for {n, left} <- [{3, 0.2}, {4, 0.95}], do: vehicle(c.console, n, left)
    vehicle(c.console, 2, 0.3, mode: %{mode: "RTL"})
    tell(script, "changed")
    await_line(script, "full")
    vehicle(c.console, 2, 0.05, mode: %{mode: "RTL", failsafe: true})
    take_charge(c.console, 2, "olga")
    tell(script, "alarmed")
    await_line(script, "ok")
  end

  test "a page that is not live yet says so; keys that do nothing say why; a lost gateway covers nothing",
       c do
    script = browser(c.slow, "hand.mjs", ["live"])
    await_line(script, "signed in")
    :ok = SlowLine.hold(c.proxy)
    tell(script, "held")
    await_line(script, "off")
    :ok = SlowLine.release(c.proxy)
    tell(script, "released")
    await_line(script, "selected")
    assert commanded(c.console) == [{"V1", "land"}]
    :ok = stop_console(c.console)
    tell(script, "gone")
    await_line(script, "lost")
    start_console(gateway: c.console.gateway, dir: c.console.dir, port: c.console.port)
    tell(script, "back")
    await_line(script, "ok")
  end
end
