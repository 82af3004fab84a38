defmodule Msp.Firmware.Inav do
  @moduledoc """
  iNav; versions of messages are those of the firmware. Its lowest arming flags are states and keep nothing from being
  armed.
  """
  @behaviour Msp.Firmware

  alias Msp.Firmware

  @majors 7..9
  @arming ~w(GEOZONE FAILSAFE_SYSTEM NOT_LEVEL SENSORS_CALIBRATING SYSTEM_OVERLOADED NAVIGATION_UNSAFE
             COMPASS_NOT_CALIBRATED ACCELEROMETER_NOT_CALIBRATED ARM_SWITCH HARDWARE_FAILURE BOXFAILSAFE BOXKILLSWITCH
             RC_LINK THROTTLE CLI CMS_MENU OSD_MENU ROLLPITCH_NOT_CENTERED SERVO_AUTOTRIM OOM INVALID_SETTING
             PWM_OUTPUT_ERROR NO_PREARM DSHOT_BEEPER LANDING_DETECTED)
          |> Enum.with_index(6)
          |> Map.new(fn {name, bit} -> {bit, name} end)

  @impl true
  def facts do
    %Firmware{
      name: :inav,
      title: "iNav",
      variant: "INAV",
      about: ["UID", "NAME", "BOXIDS", "MSP2_INAV_MIXER"],
      # MAVLINK2, PARAM_ENCODE_BYTEWISE and MISSION_INT
      capabilities: 8192 + 16 + 4,
      missions?: true,
      settings?: true,
      quiet_flag?: true,
      features: "FEATURE",
      still: "MSP2_INAV_MISC",
      modes: [
        {27, "FAILSAFE"},
        {12, "MANUAL"},
        {36, "NAV LAUNCH"},
        {10, "NAV RTH"},
        {28, "NAV WP"},
        {11, "NAV POSHOLD"},
        {53, "NAV CRUISE"},
        {45, "NAV COURSE HOLD"},
        {3, "NAV ALTHOLD"},
        {1, "ANGLE"},
        {2, "HORIZON"},
        {64, "ANGLE HOLD"},
        {29, "ACRO AIR"},
        {0, "ACRO"}
      ],
      standard: %{10 => 5, 11 => 1, 28 => 6, 3 => 4, 53 => 3},
      returns: 10,
      plan: nil,
      prearm: 51,
      arming: [{{0, 0}, @arming}],
      arming_states: 0b111111,
      rx_lost: {18, :disarmed},
      booting: [],
      sensors: [{5, :OPTICAL_FLOW}, {6, :DIFFERENTIAL_PRESSURE}],
      # Its platform types.
      types: %{FIXED_WING: [1], HELICOPTER: [2], TRICOPTER: [3], GROUND_ROVER: [4], SURFACE_BOAT: [5]},
      other_type: :GENERIC_MULTIROTOR,
      fixes: %{0 => 1, 1 => 2, 2 => 3, other: 1},
      home_told?: true,
      receiver: {:type, 2},
      receiver_setting: "receiver_type = MSP",
      hands_back: {0, 0},
      nudged?: true
    }
  end

  @impl true
  def identify({1, _minor}, _release, _numbers),
    do: {:error, "iNav's port for a video unit, which cannot be controlled: use another port of the vehicle"}

  def identify(_api, release, {major, minor, _patch}) do
    text = "iNav #{release}"

    if major in @majors,
      do: {:ok, {major, minor}, text},
      else: {:error, "#{text}, which Aerie does not know: it knows iNav 7 to 9"}
  end
end
