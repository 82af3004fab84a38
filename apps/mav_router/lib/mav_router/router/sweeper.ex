defmodule MavRouter.Router.Sweeper do
  @every_ms 10_000

  @moduledoc """
  Removes what is old from the router's tables, every #{div(@every_ms, 1_000)} s: routes, refusals, rate limits, loads, and whose
  heartbeats vehicles obey that are gone.
  """
  use GenServer

  alias Aerie.Base.Names
  alias MavRouter.Forward.GroundStations
  alias MavRouter.Routes
  alias MavRouter.Forward.Holders
  alias MavRouter.Tables

  @load_ttl_ms 60_000
  @limit_ttl_us 60_000_000
  @max_limits 65_536

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, gateway, name: Names.via(gateway, :router_sweeper))
  end

  @impl GenServer
  def init(gateway) do
    Process.set_label({:router_sweeper, gateway})
    {:ok, _timer} = :timer.send_interval(@every_ms, :sweep)
    {:ok, gateway}
  end

  @impl GenServer
  def handle_info(:sweep, gateway) do
    _swept =
      case Tables.of(gateway) do
        nil ->
          0

        tables ->
          sweep(tables, System.monotonic_time(:millisecond), &Holders.needed?(tables, gateway, &1, &2))
      end

    {:noreply, gateway}
  end

  # The answer that `MavRouter.Identity.Watchdog` waits for.
  def handle_info({:watchdog, watchdog, tag}, gateway) do
    send(watchdog, {:alive, tag, self()})
    {:noreply, gateway}
  end

  @doc "One sweep at a monotonic time in ms; gives how many routes it removed. `needed?` is as for `Routes.sweep/3`."
  @spec sweep(Tables.t(), integer, Routes.needed?()) :: non_neg_integer
  def sweep(tables, now, needed? \\ fn _endpoint, _now -> false end) do
    :ets.select_delete(tables.refused, [{{:_, :"$1"}, [{:<, :"$1", now}], [true]}])
    :ets.select_delete(tables.load, [{{:_, :"$1", :_}, [{:<, :"$1", now - @load_ttl_ms}], [true]}])
    limits(tables.limits, now * 1000 - @limit_ttl_us)
    GroundStations.sweep(tables, now)
    swept = Routes.sweep(tables, now, needed?)
    Holders.sweep(tables)
    swept
  end

  # Streams that ended; all of them, if somebody invents sources faster than they end.
  defp limits(table, before) do
    :ets.select_delete(table, [{{:_, :"$1"}, [{:<, :"$1", before}], [true]}])
    if :ets.info(table, :size) > @max_limits, do: :ets.delete_all_objects(table)
  end
end
