defmodule Aerie.Control.CommandExecutor.Offers do
  @moduledoc """
  What may be offered to somebody for a vehicle: buttons, keys and lists ask here before they show a command. Pure.
  """

  alias Aerie.Control.CommandExecutor.Observed
  alias Aerie.Control.Policy.{Intent, Roles}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Rules.Role
  alias Aerie.Vehicle.{Command, Firmware, Protocol}
  alias Aerie.Vehicle.Command.Type

  # Fences and limits ask for permissions by what a command says, not by its type.
  @unlimited %{fence: nil, max_altitude: nil, min_altitude: nil, max_altitude_msl: nil}

  @typedoc """
    * `{:firmware, reason}` - the vehicle's firmware lacks it, with these parameters if they are given
    * `{:permission, permission, reason}` - the policy wants a permission that the source does not have
  """
  @type lack :: {:firmware, String.t()} | {:permission, Type.permission(), String.t()}

  @doc """
  Why somebody cannot give a command to the vehicle of a snapshot. nil: it may be offered, and
  `Aerie.Control.Commands.check/2` says what would become of it now.
  """
  @spec lacks(vehicle :: map(), type :: String.t(), Roles.source(), params :: map()) :: lack() | nil
  def lacks(%{autopilot: autopilot} = snapshot, type, source, params \\ %{}) do
    with nil <- Firmware.of(autopilot).gap(type, snapshot.vehicle_type),
         nil <- gap(snapshot, Command.new(vehicle: snapshot.id, type: type, params: params)),
         context = Context.seen(snapshot, nil, source, System.os_time(:microsecond)),
         nil <- Role.lacking(@unlimited, Intent.named(type), context) do
      nil
    else
      {permission, {:deny, :role, reason}} -> {:permission, permission, reason}
      reason -> {:firmware, reason}
    end
  end

  defp gap(snapshot, {:ok, command}),
    do: with({:gap, reason} <- plan(command, snapshot), do: reason, else: (_other -> nil))

  # Not all parameters are known yet.
  defp gap(_snapshot, {:error, _incomplete}), do: nil

  @doc "The steps of a command for a vehicle that this gateway hears; of another gateway's vehicle that knows more."
  @spec plan(Command.t(), vehicle :: map()) ::
          {:ok, Protocol.plan()} | {:gap, String.t()} | {:error, String.t()}
  def plan(_command, %{via: via}) when via != nil, do: {:ok, []}

  def plan(command, snapshot),
    do: Protocol.plan(Firmware.of(snapshot.autopilot), command, Observed.vehicle(snapshot, {1, 1}))
end
