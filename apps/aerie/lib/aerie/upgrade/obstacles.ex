defmodule Aerie.Upgrade.Obstacles do
  @moduledoc """
  What would be lost if the gateway ended now, each as a line for a person. State, events, desired states, recordings and the results of
  commands are not among it: they are on the disk, in NATS or come again from the vehicle.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Commands.Recent
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Control.Policy.Memory.RecentCommands
  alias Aerie.Fleet.Operations
  alias MavRouter.Sharing.TransferLock

  @sticks ~w(rc_override manual_control)
  # Sticks come at 5 Hz or more.
  @steered_us 2_000_000

  @doc "All of them; none means that nothing would be lost."
  @spec list(Names.gateway()) :: [String.t()]
  def list(gateway) do
    turns = Enum.group_by(TransferLock.turns(gateway), &elem(&1, 0), &elem(&1, 1))

    vehicles =
      for vehicle <- Store.vehicles(gateway),
          text <- of(gateway, vehicle, turns),
          do: "#{vehicle.id}: #{text}"

    operations =
      for %{"state" => "running", "id" => id} <- Operations.list(gateway), do: "operation #{id} is under way"

    vehicles ++ operations
  end

  defp of(gateway, %{id: id, key: key}, turns) do
    commands =
      for %{type: type, source: source} <- Recent.of(gateway, id, 0), do: "#{type} of #{source} is under way"

    transfers = for kind <- Map.get(turns, key, []), do: "a transfer (#{kind}) is under way"
    commands ++ transfers ++ steered(gateway, id) ++ in_charge(gateway, key)
  end

  # It would miss them for a second, which may be its failsafe.
  defp steered(gateway, id) do
    cond do
      RecentCommands.setpoints_ms(gateway, id) != nil ->
        ["set-points steer it"]

      sticks = sticks(RecentCommands.last(gateway, id)) ->
        ["#{sticks} steers it by its sticks"]

      true ->
        []
    end
  end

  defp sticks(%{type: type, source: source, at: at}) when type in @sticks,
    do: if(System.os_time(:microsecond) - at < @steered_us, do: source)

  defp sticks(_other), do: nil

  defp in_charge(gateway, key) do
    case Holders.of(gateway, key) do
      %{holder: holder, offered_to: offered} when offered != :anyone -> ["#{holder} is in charge of it"]
      _nobody -> []
    end
  end
end
