defmodule Aerie.Control.Policy.ControlLease.Announcer do
  @moduledoc """
  Tells who is in charge of a vehicle (`Aerie.Control.Policy.ControlLease.Holders`): in its state, as the group `operator`, and by the event
  `operator.changed`. A change does not wait for that.
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Policy.ControlLease
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Base.PubSub
  alias Aerie.Vehicle.Events.External

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options),
    do:
      GenServer.start_link(__MODULE__, options[:gateway],
        name: Names.via(options[:gateway], :command_control)
      )

  @impl GenServer
  def init(gateway) do
    Process.set_label({:command_control, gateway})
    :ok = PubSub.subscribe(gateway, :leases)
    leases = Holders.all(gateway)
    # The changes while this process was away.
    for {key, lease} <- leases, do: announce(gateway, key, lease)
    {:ok, %{gateway: gateway, holders: Map.new(leases, fn {key, lease} -> {key, lease.holder} end)}}
  end

  @impl GenServer
  def handle_info({:fleet, :leases, {key, lease}}, %{gateway: gateway} = state) do
    announce(gateway, key, lease)
    before = state.holders[key]
    holder = lease && lease.holder

    if holder != before do
      data = %{operator: holder, before: before, via: lease && lease.via, reason: lease && lease.reason}
      External.event(gateway, key, "operator.changed", data, System.os_time(:microsecond))
    end

    holders = if holder, do: Map.put(state.holders, key, holder), else: Map.delete(state.holders, key)
    {:noreply, %{state | holders: holders}}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp announce(gateway, key, lease) do
    with session when is_pid(session) <- Names.whereis(gateway, :session, key),
         %{} <- Store.vehicle(gateway, key),
         do: send(session, {:operator, fields(lease)})

    :ok
  end

  defp fields(nil), do: %{name: nil, via: nil, since: nil, reason: nil, offered_to: nil}

  defp fields(%ControlLease{} = lease) do
    %{
      name: lease.holder,
      via: lease.via,
      since: lease.since |> DateTime.from_unix!(:microsecond) |> DateTime.to_iso8601(),
      reason: lease.reason,
      offered_to: if(lease.offered_to == :anyone, do: "*", else: lease.offered_to)
    }
  end
end
