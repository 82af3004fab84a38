defmodule MavRouter.Forward.GroundStationsTest do
  use ExUnit.Case, async: true

  alias MavRouter.Forward.GroundStations
  alias Aerie.Base.Store

  @hour 3_600_000_000

  setup do
    gateway = make_ref()
    start_supervised!({Store, gateway: gateway})
    {:ok, gateway: gateway}
  end

  defp station(system, at), do: %{system: system, component: 190, type: 6, via: "radio", last_heard: at}
  defp now, do: System.os_time(:microsecond)

  # What the table has is as if it had been written before the clock was set by `step`.
  defp set_clock(gateway, step) do
    table = Store.table!(gateway, :stations)

    for {key, at, live, station} <- :ets.tab2list(table) do
      :ets.insert(table, {key, at - step, live && live - step, %{station | last_heard: at - step}})
    end
  end

  test "a network's own stations, the last heartbeat of each", %{gateway: gateway} do
    at = now()
    :ok = GroundStations.hear(gateway, "main", station(255, at - 1))
    :ok = GroundStations.hear(gateway, "main", station(255, at))
    :ok = GroundStations.hear(gateway, "other", station(254, at))
    assert GroundStations.list(gateway, "main") == [station(255, at)]
    :ok = GroundStations.hear(gateway, "none", station(253, nil))
    assert [%{last_heard: heard}] = GroundStations.list(gateway, "none")
    assert heard >= at
  end

  test "H5: after the clock was set, a station was heard as long ago as before", %{gateway: gateway} do
    for step <- [-@hour, @hour] do
      at = now()
      :ok = GroundStations.hear(gateway, "main", station(255, at))
      set_clock(gateway, step)
      [%{last_heard: heard}] = GroundStations.list(gateway, "main")
      # Two readings of the clocks, with what the machine did between them.
      assert_in_delta heard, at, 500_000
    end
  end

  test "times of a recording are its own", %{gateway: gateway} do
    :ok = GroundStations.hear(gateway, "main", station(255, 1_000_000))
    set_clock(gateway, @hour)
    assert [%{last_heard: at}] = GroundStations.list(gateway, "main")
    assert at == 1_000_000 - @hour
  end

  test "as many as there is room for; those of long ago, and of a clock that was set back, make room", c do
    at = now()
    for n <- 1..1_024, do: :ok = GroundStations.hear(c.gateway, "main", station(n, at + @hour))
    :ok = GroundStations.hear(c.gateway, "main", station(5_000, at))
    assert [%{system: 5_000}] = GroundStations.list(c.gateway, "main")
    for n <- 1..1_023, do: :ok = GroundStations.hear(c.gateway, "main", station(n, at))
    :ok = GroundStations.hear(c.gateway, "main", station(6_000, at))
    assert length(GroundStations.list(c.gateway, "main")) == 1_024
    assert Store.counter(c.gateway, {:stations, :dropped}) == 1
  end
end
