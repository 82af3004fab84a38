defmodule Aerie.Control.Mission.Review do
  @moduledoc "The review of plans by the policy (`Aerie.Control.Policy.Mavlink.Review`)."

  alias Aerie.Base.Names
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Roles
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Mavlink.Review
  alias Aerie.Vehicle.Firmware
  alias Protocols.Mission.{Onboard, Plan}

  defdelegate plan(policy, items, type, vehicle, context), to: Review
  defdelegate place(item, vehicle), to: Review

  @doc """
  What the policy has against the parts of a plan for the vehicle of a snapshot, if `source` sends them: the part, the
  number of the item there (nil: the part as a whole), and the reason.
  """
  @spec of_parts(Names.gateway(), Plan.t(), [Plan.kind()], map(), Roles.source()) ::
          {:ok, [{Plan.kind(), non_neg_integer() | nil, String.t()}]} | {:error, :no_policy}
  def of_parts(gateway, plan, parts, snapshot, source) do
    case Policy.in_force(gateway) do
      nil ->
        {:error, :no_policy}

      policy ->
        protocol = Firmware.of(snapshot.autopilot)
        vehicle = Map.take(snapshot, [:autopilot, :vehicle_type])
        context = Context.of(gateway, snapshot, source, System.os_time(:microsecond))

        {:ok,
         for {type, part} <- [{0, :mission}, {1, :fence}, {2, :rally}],
             part in parts,
             [_ | _] = items <- [Onboard.items(plan, type, protocol)],
             {:deny, _rule, seq, reason} <- [plan(policy, items, type, vehicle, context)] do
           {part, index(part, seq, protocol), reason}
         end}
    end
  end

  # The vehicle counts home if it is an item.
  defp index(:mission, seq, protocol) when is_integer(seq) do
    index = if protocol.home_is_item_0?(), do: seq - 1, else: seq
    if index >= 0, do: index
  end

  defp index(_part, _seq, _protocol), do: nil
end
