defmodule Aerie.Control.Mission.Known do
  @moduledoc """
  The policy's review of a plan that somebody draws or sends, and what the vehicle has of it: the policy judges by that
  what may take its place, and where a mission leads that is begun (`Aerie.Control.Policy.Mavlink.Writing.Aboard`).
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Roles
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Mavlink.{Review, Writing}
  alias Aerie.Control.Policy.Mavlink.Writing.Aboard
  alias Protocols.Mission.{Item, Onboard, Plan}
  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.Command.{Refusal, Result}

  @fence 1

  @doc "Remembers the outcome of an upload, and gives it back; `snapshot` nil: there is no such vehicle."
  @spec note(answer, Names.gateway(), map() | nil, 0..2, [Item.t()]) :: answer when answer: term()
  def note(answer, _gateway, nil, _type, _items), do: answer

  def note(answer, gateway, %{key: key}, type, items) do
    whole? = match?({:ok, %Result{status: status}} when status in [:completed, :accepted], answer)
    Aboard.sent(gateway, key, type, if(whole?, do: items))
    answer
  end

  @doc """
  The review of a plan. Without the permission to take a fence away a source may put one in its place that keeps as
  much; `read` reads the one aboard if it is not known.
  """
  @spec review(Policy.t(), Context.t(), {Names.gateway(), map()}, [Item.t()], 0..2, (-> {:ok, map()}
                                                                                        | {:error, term()})) ::
          :allow | {:deny, Policy.rule(), String.t()}
  def review(policy, context, {gateway, snapshot}, items, type, read) do
    vehicle = Map.take(snapshot, [:autopilot, :vehicle_type])

    with :allow <- Review.plan(policy, items, type, vehicle, context),
         :allow <- replaced(context, {gateway, snapshot}, items, type, read) do
      :allow
    else
      {:deny, rule, _seq, reason} -> {:deny, rule, reason}
    end
  end

  defp replaced(context, {gateway, snapshot}, items, @fence, read) do
    if Roles.allowed?(context.source, :protection) do
      :allow
    else
      with :unknown <- Aboard.items(gateway, snapshot.key, @fence),
           {:error, _result} <- read.() do
        {:deny, :role, nil, Refusal.text(:fence_unread)}
      else
        {:ok, %{items: old}} -> Writing.kept(items, old)
        {:ok, old} -> Writing.kept(items, old)
      end
    end
  end

  defp replaced(_context, _vehicle, _items, _type, _read), do: :allow

  @doc "The refusals of `Aerie.Control.Missions.refused/5`."
  @spec refused(Names.gateway(), Plan.t(), [Plan.kind()], map(), Roles.source()) ::
          {:ok, [{Plan.kind(), non_neg_integer() | nil, String.t()}]} | {:error, String.t()}
  def refused(gateway, plan, parts, snapshot, source) do
    case Policy.in_force(gateway) do
      nil ->
        {:error, Refusal.text(:no_policy_for_plans)}

      policy ->
        protocol = Firmware.of(snapshot.autopilot)
        vehicle = Map.take(snapshot, [:autopilot, :vehicle_type])
        context = Context.of(gateway, snapshot, source, System.os_time(:microsecond))

        {:ok,
         for {type, part} <- [{0, :mission}, {1, :fence}, {2, :rally}],
             part in parts,
             [_ | _] = items <- [Onboard.items(plan, type, protocol)],
             {:deny, _rule, seq, reason} <- [Review.plan(policy, items, type, vehicle, context)] do
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
