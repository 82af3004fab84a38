defmodule Aerie.Control.Commands.OffboardPrecondition do
  @moduledoc """
  PX4 flies OFFBOARD only while set-points come: they must have come for a second before the mode is requested (X7). Without them PX4 may
  acknowledge the request all the same, so the gateway refuses it at once.

  Set-points of commands and of clients' raw MAVLink are known (`Aerie.Control.Policy.Memory.RecentCommands`). A sender whose set-points do not
  pass through the gateway says so with `setpoints_elsewhere`.
  """

  alias Aerie.Base.Names
  alias Aerie.Vehicle.Command.Refusal
  alias Aerie.Vehicle.{Command, Firmware}
  alias Aerie.Control.Policy.Memory.RecentCommands
  alias Aerie.Control.CommandExecutor.Observed

  @wanted_ms 1_000

  @doc "Whether a command may be sent to the vehicle of a snapshot as far as set-points are concerned."
  @spec check(Names.gateway(), Command.t(), map()) :: :ok | Refusal.denial()
  def check(_gateway, %{params: %{setpoints_elsewhere: true}}, _snapshot), do: :ok

  def check(gateway, command, snapshot) do
    if Firmware.of(snapshot.autopilot).setpoints_first?(command, Observed.vehicle(snapshot, {1, 1})),
      do: check_stream(RecentCommands.setpoints_ms(gateway, command.vehicle)),
      else: :ok
  end

  defp check_stream(ms) when is_integer(ms) and ms >= @wanted_ms, do: :ok

  defp check_stream(nil), do: Refusal.deny(:setpoints, since: Refusal.text(:setpoints_none))
  defp check_stream(ms), do: Refusal.deny(:setpoints, since: Refusal.text(:setpoints_since, ms: ms))
end
