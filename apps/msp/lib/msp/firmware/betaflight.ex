defmodule Msp.Firmware.Betaflight do
  @moduledoc """
  Betaflight; versions of messages are those of the API.

  Its last arming flag, ARM_SWITCH, only says that the switch is on although something else is in the way. Before API
  1.42 the flags have numbers instead of names.
  """
  @behaviour Msp.Firmware

  alias Msp.Firmware

  @minors 40..49

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
  @old Map.merge(@common, %{3 => "BAD_RX_RECOVERY", 20 => "RPMFILTER"})
  @since_1_43 %{23 => "ACC_CALIBRATION", 24 => "MOTOR_PROTOCOL"}
  @since_1_47 Map.merge(@since_1_43, %{25 => "CRASHFLIP", 26 => "ALTHOLD", 27 => "POSHOLD"})
  @since_1_48 Map.put(@since_1_47, 28, "AUTOPILOT")
  @arm_switch "ARM_SWITCH"
  @arming [
    {{1, 48}, @common |> Map.merge(@since_1_48) |> Map.put(29, @arm_switch)},
    {{1, 47}, @common |> Map.merge(@since_1_47) |> Map.put(28, @arm_switch)},
    {{1, 46}, @common |> Map.merge(@since_1_43) |> Map.put(25, @arm_switch)},
    {{1, 43}, @old |> Map.merge(@since_1_43) |> Map.put(25, @arm_switch)},
    {{1, 42}, Map.put(@old, 23, @arm_switch)}
  ]

  @impl true
  def facts do
    %Firmware{
      name: :betaflight,
      title: "Betaflight",
      variant: "BTFL",
      about: ["UID", "NAME", "BOXIDS", "MIXER_CONFIG"],
      # MAVLINK2 and PARAM_ENCODE_BYTEWISE
      capabilities: 8192 + 16,
      missions?: false,
      settings?: false,
      quiet_flag?: false,
      features: "FEATURE_CONFIG",
      modes: [
        {27, "FAILSAFE"},
        {46, "GPS RESCUE"},
        {56, "AUTOPILOT"},
        {12, "PASSTHRU"},
        {11, "POS HOLD"},
        {3, "ALTHOLD"},
        {1, "ANGLE"},
        {2, "HORIZON"},
        {55, "CHIRP"},
        {47, "ACRO TRAINER"},
        {28, "AIR MODE"},
        {0, "ACRO"}
      ],
      standard: %{46 => 5, 11 => 1, 3 => 4},
      returns: 46,
      plan: 56,
      prearm: 36,
      arming: @arming,
      arming_states: 0,
      rx_lost: {2, :always},
      booting: [{{1, 42}, 9}, {{0, 0}, 8}],
      sensors: [{5, :"3D_GYRO"}, {6, :OPTICAL_FLOW}],
      # Its mixers, which are all copters but for the wings.
      types: %{
        TRICOPTER: [1],
        QUADROTOR: [2, 3],
        HEXAROTOR: [7, 10],
        OCTOROTOR: [11, 12, 13],
        FIXED_WING: [8, 14]
      },
      other_type: :QUADROTOR,
      # A mask, of which a fix is a bit; it does not say whether there is a height.
      fixes: %{0 => 1, other: 3},
      home_told?: false,
      receiver: {:feature, 14},
      receiver_setting: "feature RX_MSP",
      hands_back: {1, 48},
      nudged?: false
    }
  end

  @impl true
  def identify({major, minor} = api, release, _numbers) do
    text = "Betaflight #{release} (API #{major}.#{minor})"

    if major == 1 and minor in @minors,
      do: {:ok, api, text},
      else: {:error, "#{text}, which Aerie does not know: it knows API 1.40 to 1.49 (3.5 to 2026.12)"}
  end
end
