defmodule Msp.Arming do
  @moduledoc """
  What keeps a vehicle from being armed: names of the arming flags, whose bits differ between firmwares and versions.

  Betaflight's last flag, ARM_SWITCH, only says that the switch is on although something else is in the way. iNav's lowest bits are
  states and keep nothing from being armed. Betaflight before API 1.42 gets numbers instead of names.
  """

  import Bitwise

  @common %{
    0 => "NO_GYRO",
    1 => "FAILSAFE",
    2 => "RX_FAILSAFE",
    3 => "NOT_DISARMED",
    4 => "BOXFAILSAFE",
    5 => "RUNAWAY_TAKEOFF",
    6 => "CRASH_DETECTED",
    7 => "THROTTLE",
    8 => "ANGLE",
    9 => "BOOT_GRACE_TIME",
    10 => "NOPREARM",
    11 => "LOAD",
    12 => "CALIBRATING",
    13 => "CLI",
    14 => "CMS_MENU",
    15 => "BST",
    16 => "MSP",
    17 => "PARALYZE",
    18 => "GPS",
    19 => "RESC",
    20 => "DSHOT_TELEM",
    21 => "REBOOT_REQUIRED",
    22 => "DSHOT_BITBANG"
  }
  @old %{3 => "BAD_RX_RECOVERY", 20 => "RPMFILTER"}
  @since_1_43 %{23 => "ACC_CALIBRATION", 24 => "MOTOR_PROTOCOL"}
  @since_1_47 %{25 => "CRASHFLIP", 26 => "ALTHOLD", 27 => "POSHOLD"}
  @since_1_48 %{28 => "AUTOPILOT"}
  # By the first version that has them: the names, and the bit of ARM_SWITCH.
  @betaflight [
    {{1, 48}, [@common, @since_1_43, @since_1_47, @since_1_48], 29},
    {{1, 47}, [@common, @since_1_43, @since_1_47], 28},
    {{1, 46}, [@common, @since_1_43], 25},
    {{1, 43}, [@common, @old, @since_1_43], 25},
    {{1, 42}, [@common, @old], 23}
  ]
  @inav ~w(GEOZONE FAILSAFE_SYSTEM NOT_LEVEL SENSORS_CALIBRATING SYSTEM_OVERLOADED NAVIGATION_UNSAFE COMPASS_NOT_CALIBRATED
           ACCELEROMETER_NOT_CALIBRATED ARM_SWITCH HARDWARE_FAILURE BOXFAILSAFE BOXKILLSWITCH RC_LINK THROTTLE CLI CMS_MENU
           OSD_MENU ROLLPITCH_NOT_CENTERED SERVO_AUTOTRIM OOM INVALID_SETTING PWM_OUTPUT_ERROR NO_PREARM DSHOT_BEEPER
           LANDING_DETECTED)
        |> Enum.with_index(6)
        |> Map.new(fn {name, bit} -> {bit, name} end)
  @inav_states 0b111111

  @type flags :: non_neg_integer

  @doc """
  The names of the flags that are on, a number for one without a name.

      iex> Msp.Arming.names({:betaflight, {1, 46}}, 0b100 + 0x2000000)
      ["RX_FAILSAFE", "ARM_SWITCH"]
      iex> Msp.Arming.names({:inav, {9, 0}}, 0b1100)
      []
  """
  @spec names(MavCodec.Msp.Guard.target(), flags) :: [String.t()]
  def names({:inav, _version}, flags), do: named(flags &&& bnot(@inav_states), @inav)

  def names({:betaflight, version}, flags) do
    case Enum.find(@betaflight, fn {since, _names, _last} -> version >= since end) do
      nil ->
        named(flags, %{})

      {_since, tables, last} ->
        named(flags, tables |> Enum.reduce(&Map.merge(&2, &1)) |> Map.put(last, "ARM_SWITCH"))
    end
  end

  defp named(flags, names) do
    for bit <- 0..31, (flags >>> bit &&& 1) == 1, do: Map.get(names, bit, "flag #{bit}")
  end

  @doc "Whether the receiver is lost; nil where the flags do not say (iNav while it is armed)."
  @spec rc_lost?(MavCodec.Msp.Guard.target(), flags, armed? :: boolean) :: boolean | nil
  def rc_lost?({:betaflight, _version}, flags, _armed?), do: (flags &&& 0b100) != 0
  def rc_lost?({:inav, _version}, _flags, true), do: nil
  def rc_lost?({:inav, _version}, flags, false), do: (flags >>> 18 &&& 1) == 1

  @doc "Whether the vehicle has just started: Betaflight does not arm for some seconds after that."
  @spec booting?(MavCodec.Msp.Guard.target(), flags) :: boolean
  def booting?({:betaflight, version}, flags),
    do: (flags >>> if(version >= {1, 42}, do: 9, else: 8) &&& 1) == 1

  def booting?({:inav, _version}, _flags), do: false
end
