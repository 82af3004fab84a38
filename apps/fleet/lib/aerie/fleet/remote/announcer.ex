defmodule Aerie.Fleet.Remote.Announcer do
  @moduledoc """
  Tells the other gateways which vehicles this one hears: the state group `gateway` of each, every `remote.announce_s`. A vehicle
  that is not heard is announced too, so that the others know it is lost; one of a recording is not.
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet.Bridge
  alias Aerie.Fleet.Remote.{Message, Settings}

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :remote_announcer))

  @impl GenServer
  def init(gateway: gateway, settings: settings) do
    Process.set_label({:remote_announcer, gateway})
    {:ok, schedule(%{gateway: gateway, every_ms: settings.announce_ms})}
  end

  @impl GenServer
  def handle_info({:timeout, _timer, :announce}, state) do
    announce(state.gateway)
    {:noreply, schedule(state)}
  end

  def handle_info(_late, state), do: {:noreply, state}

  defp announce(gateway) do
    now = System.os_time(:microsecond)

    for snapshot <- Store.vehicles(gateway), not recorded?(gateway, snapshot) do
      Bridge.publish_state(gateway, snapshot.id, :gateway, %{data: Message.facts(snapshot, now)}, now)
    end

    :ok
  end

  defp recorded?(gateway, %{links: links}),
    do: Enum.any?(links, &match?(%{spec: %{recorded: true}}, Store.link(gateway, &1)))

  defp schedule(state) do
    _timer = :erlang.start_timer(state.every_ms, self(), :announce)
    state
  end
end
