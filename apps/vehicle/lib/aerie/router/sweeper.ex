defmodule Aerie.Router.Sweeper do
  @moduledoc "Sweeps old routes, refusals and load notes out of the router's tables, every ten seconds."
  use GenServer

  alias Aerie.Names
  alias Aerie.Router.Routes
  alias Aerie.Router.Tables

  @every_ms 10_000
  @load_ttl_ms 60_000

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
        nil -> 0
        tables -> sweep(tables, System.monotonic_time(:millisecond))
      end

    {:noreply, gateway}
  end

  def handle_info({:pulse, pulse, tag}, gateway) do
    # A loop that turns says so (`Aerie.Vehicle.Identity.Pulse`).
    send(pulse, {:alive, tag, self()})
    {:noreply, gateway}
  end

  @doc "One sweep at a monotonic time in ms; how many routes went."
  @spec sweep(Tables.t(), integer) :: non_neg_integer
  def sweep(tables, now) do
    :ets.select_delete(tables.refused, [{{:_, :"$1"}, [{:<, :"$1", now}], [true]}])
    :ets.select_delete(tables.load, [{{:_, :"$1", :_}, [{:<, :"$1", now - @load_ttl_ms}], [true]}])
    Routes.sweep(tables, now)
  end
end
