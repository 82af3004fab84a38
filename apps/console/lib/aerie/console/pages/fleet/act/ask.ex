defmodule Aerie.Console.Pages.Fleet.Act.Ask do
  @moduledoc "What a sheet may ask of the gateway, as its user sees it. The sheets are pure: they get these functions."

  alias Aerie.Base.Names
  alias Aerie.Control.Commands
  alias Aerie.Fleet
  alias Aerie.Vehicle.Snapshot

  @typedoc """
    * `:refusal` - why the firmware, the user's rights or the policy refuse one of these commands; one without
      parameters is not put to the policy, and the rules named last do not count
    * `:readiness` - of a vehicle; `:own_return_m` - the height of its own to which it climbs before it returns
  """
  @type t :: %{
          refusal: (Snapshot.t(), [{String.t(), map() | nil}], overlooked :: [atom()] -> String.t() | nil),
          readiness: (Snapshot.t() -> map()),
          own_return_m: (Snapshot.t() -> number() | nil)
        }

  @doc "The functions for a user."
  @spec of(Names.gateway(), user :: map()) :: t()
  def of(gateway, user) do
    %{
      refusal: fn vehicle, commands, overlooked ->
        Enum.find_value(commands, &refusal(gateway, user, vehicle, &1, overlooked))
      end,
      readiness: &Fleet.readinesses(gateway, [&1], user.name)[&1.id],
      own_return_m: &Fleet.own_return_m(gateway, &1.id)
    }
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
