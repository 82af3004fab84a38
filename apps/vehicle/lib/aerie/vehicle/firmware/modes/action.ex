defmodule Aerie.Vehicle.Firmware.Modes.Action do
  @moduledoc "What a vehicle does by itself in a mode, whatever its firmware calls it. Pure."

  @actions %{
    return: ~w(RTL AUTO_RTL SMART_RTL QRTL RTH NAV_RTH GPSRESCUE),
    land: ~w(LAND AUTO_LAND AUTO_PRECLAND AUTOLAND AUTO_DESCEND QLAND LOITER_ALT_QLAND EMERG_LANDING),
    mission: ~w(AUTO AUTO_MISSION NAV_WP),
    take_off: ~w(TAKEOFF AUTO_TAKEOFF AUTO_VTOL_TAKEOFF),
    hold: ~w(HOLD AUTO_LOITER BRAKE LOITER QLOITER POSHOLD POSCTL POSCTL_SLOW FLOWHOLD NAV_POSHOLD),
    hold_height: ~w(ALT_HOLD ALTCTL QHOVER FBWB ALTHOLD),
    orbit: ~w(CIRCLE POSCTL_ORBIT),
    follow: ~w(FOLLOW AUTO_FOLLOW_TARGET),
    guided: ~w(GUIDED OFFBOARD GUIDED_NOGPS)
  }
  @words %{
    return: "Return",
    land: "Land",
    mission: "Mission",
    take_off: "Take off",
    hold: "Hold",
    hold_height: "Hold height",
    orbit: "Orbit",
    follow: "Follow",
    guided: "Guided"
  }
  @by_mode for {action, modes} <- @actions, mode <- modes, into: %{}, do: {mode, action}

  @type t ::
          :return | :land | :mission | :take_off | :hold | :hold_height | :orbit | :follow | :guided

  @doc "The action of a mode; nil for one in which a pilot flies, and one that is not known."
  @spec of(mode :: String.t() | nil) :: t() | nil
  def of(mode), do: @by_mode[mode]

  @doc "An action for people."
  @spec word(t()) :: String.t()
  def word(action), do: Map.fetch!(@words, action)

  @doc "The mode for an action among those of a vehicle; nil if it has none. A firmware's usual one comes first."
  @spec among(t(), modes :: [String.t()]) :: String.t() | nil
  def among(action, modes), do: Enum.find(Map.fetch!(@actions, action), &(&1 in modes))
end
