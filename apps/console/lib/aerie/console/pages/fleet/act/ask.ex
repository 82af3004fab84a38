defmodule Aerie.Console.Pages.Fleet.Act.Ask do
  @moduledoc "What a sheet may ask of the gateway, as its user sees it. The sheets are pure: they get these functions."

  alias Aerie.Base.Names
  alias Aerie.Access.WorkLimit
  alias Aerie.Control.{Commands, Missions, Policy}
  alias Aerie.Control.Policy.Roles
  alias Aerie.Fleet
  alias Aerie.Fleet.Shadow
  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.Snapshot
  alias Protocols.Mission.Plan

  @typedoc """
    * `:refusal` - why the firmware, the user's rights or the policy refuse one of these commands; one without
      parameters is not put to the policy, and the rules named last do not count
    * `:readiness` - of a vehicle; `:own_return_m` - the height of its own to which it climbs before it returns
    * `:no_mission` - why the gateway would not send a mission to a vehicle now; `:plan_refusal` - why not this plan
    * `:parse` - the plans of files; `:put_plan` - stores one; `:compare` - plans against each other; `:tags` of all
  """
  @type t :: %{
          refusal: (Snapshot.t(), [{String.t(), map() | nil}], overlooked :: [atom()] -> String.t() | nil),
          readiness: (Snapshot.t() -> map()),
          own_return_m: (Snapshot.t() -> number() | nil),
          no_mission: (Snapshot.t() -> String.t() | nil),
          plan_refusal: (Plan.t(), Snapshot.t() -> String.t() | nil),
          parse: ([{name :: String.t(), text :: String.t()}] ->
                    {:ok, [{String.t(), {:ok, Plan.t()} | {:error, String.t()}}]} | {:busy, pos_integer()}),
          put_plan: (text :: String.t() -> {:ok, hash :: String.t()} | {:error, {atom(), String.t()}}),
          compare: ([{String.t(), Plan.t()}], interval_s :: number() -> map()),
          tags: (-> %{String.t() => [String.t()]})
        }

  @doc "The functions for a user."
  @spec of(Names.gateway(), user :: map()) :: t()
  def of(gateway, user) do
    %{
      refusal: fn vehicle, commands, overlooked ->
        Enum.find_value(commands, &refusal(gateway, user, vehicle, &1, overlooked))
      end,
      readiness: &Fleet.readinesses(gateway, [&1], user.name)[&1.id],
      own_return_m: &Fleet.own_return_m(gateway, &1.id),
      no_mission: &no_mission(gateway, user, &1),
      plan_refusal: fn plan, vehicle ->
        case Missions.refused(gateway, plan, [:mission], vehicle, user) do
          {:ok, []} -> nil
          {:ok, [{_part, nil, reason} | _more]} -> reason
          {:ok, [{_part, index, reason} | _more]} -> "item #{index + 1}: #{reason}"
          {:error, reason} -> reason
        end
      end,
      parse: fn files ->
        WorkLimit.run(gateway, :parse, {:name, user.name}, fn ->
          for {name, text} <- files, do: {name, Missions.import(text, :any)}
        end)
      end,
      put_plan: &Shadow.put_plan(gateway, &1, user),
      compare: &Fleet.compare_plans(gateway, &1, &2),
      tags: fn -> Shadow.tags(gateway) end
    }
  end

  # What the desired state would be held off by, as far as that lasts.
  defp no_mission(gateway, user, vehicle) do
    mode = Snapshot.data(vehicle, :mode)

    cond do
      gap = Missions.gap(vehicle, :mission) ->
        gap

      not Roles.allowed?(user, :mission) ->
        "to send missions needs the permission mission, which #{user.name} does not have"

      lease = Policy.control_leases(gateway)[vehicle.key] ->
        "it is in the charge of #{lease.holder}: the gateway sends it a mission once its control is free"

      mode[:armed] != false and Firmware.action(mode[:mode]) == :mission ->
        "it flies its mission: the gateway sends it another one when it does not"

      true ->
        nil
    end
  end

  defp refusal(gateway, user, vehicle, {type, params}, overlooked) do
    case Commands.lacks(vehicle, type, user) || (params && check(gateway, user, vehicle, type, params)) do
      nil -> nil
      :allow -> nil
      {:permission, _permission, reason} -> reason
      {:firmware, reason} -> reason
      {:deny, rule, reason} -> if rule not in overlooked, do: reason
      {:error, errors} -> Enum.join(errors, "; ")
    end
  end

  defp check(gateway, user, %{id: id}, type, params),
    do: Commands.check(gateway, vehicle: id, type: type, params: params, as: user)
end
