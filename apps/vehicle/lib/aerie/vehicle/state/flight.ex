defmodule Aerie.Vehicle.State.Flight do
  @moduledoc """
  Whether the vehicle is in the air, by the first of these that tells:

  1. A rover, boat or submarine never is.
  2. EXTENDED_SYS_STATE, if it came within the last five seconds and is not undefined.
  3. A vehicle that is not armed does not fly.
  4. The heartbeat of a firmware whose ACTIVE is flying, and STANDBY is not (in a failsafe ArduPilot says neither).
  5. The height: above 1.5 m it flies; below 0.5 m with less than 0.3 m/s vertical speed it does not; in between it is as
     before. Without a height one that flew still does; whether another one does is not known.
  """

  alias Aerie.Vehicle.{Firmware, State}
  alias Aerie.Vehicle.Protocol.Kind
  alias MavCodec.Enums.MavLandedState

  @fresh_us 5_000_000
  @up_m 1.5
  @down_m 0.5
  @still_m_s 0.3
  @on_ground MavLandedState.value(:MAV_LANDED_STATE_ON_GROUND)
  @airborne Enum.map(
              [:MAV_LANDED_STATE_IN_AIR, :MAV_LANDED_STATE_TAKEOFF, :MAV_LANDED_STATE_LANDING],
              &MavLandedState.value/1
            )

  @doc "Whether it flies now, `:same` if the state says so already; nil if it is not known."
  @spec in_air(State.t(), integer()) :: boolean() | nil | :same
  def in_air(state, at) do
    mode = State.data(state, :mode)

    case evaluate(state, mode, at) do
      same when same == mode.in_air -> :same
      in_air -> in_air
    end
  end

  defp evaluate(state, mode, at) do
    cond do
      mode.armed == nil -> nil
      not Kind.flies?(state.kind) -> false
      true -> state.landed |> landed_state(at) |> fall_back(state, mode)
    end
  end

  defp landed_state({@on_ground, heard}, at) when at - heard <= @fresh_us, do: false
  defp landed_state({landed, heard}, at) when landed in @airborne and at - heard <= @fresh_us, do: true
  defp landed_state(_undefined_old_or_never, _at), do: nil

  @doc """
  Whether a vehicle that was just disarmed may be falling: it does not detect landings itself, and is not known to be
  low enough to stand on the ground.
  """
  @spec aloft?(State.t()) :: boolean()
  def aloft?(state) do
    height = State.data(state, :position).alt_rel

    not Firmware.telemetry(state.autopilot).detects_landing? and
      State.data(state, :mode).landed_state != "ON_GROUND" and (height == nil or height > @up_m)
  end

  defp fall_back(in_air, _state, _mode) when is_boolean(in_air), do: in_air
  defp fall_back(nil, _state, %{armed: false}), do: false

  defp fall_back(nil, state, mode) do
    height = State.data(state, :position).alt_rel
    sinking = State.data(state, :velocity).vd
    by_status? = Firmware.telemetry(state.autopilot).status_flies?

    cond do
      by_status? and mode.system_status == "ACTIVE" -> true
      by_status? and mode.system_status == "STANDBY" -> false
      # It has said so, but for a failsafe.
      height == nil -> if mode.in_air || by_status?, do: mode.in_air
      height > @up_m -> true
      height < @down_m and abs(sinking || 0.0) < @still_m_s -> false
      true -> mode.in_air || false
    end
  end
end
