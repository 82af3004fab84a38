defmodule Aerie.Vehicle.Firmware.Px4.Inputs do
  @moduledoc """
  PX4's channels, by the parameters that map them (`rc_update`, `ManualControl`). Which position of a switch means what
  depends on the channel's calibration, so each position counts as the one that does the most.

  PX4 takes an override as a whole (`handle_message_rc_channels_override`): each channel up to the last one with a
  value. An ignored one in between is at its highest, and 0 does not give one of the first eight back but is its lowest.
  """

  @behaviour Aerie.Vehicle.Firmware.Inputs

  alias Aerie.Vehicle.Firmware.Inputs

  # Some versions lack the first two. The others are known only after these had their turn.
  @read ~w(
    RC_MAP_TERM_SW RC_MAP_ENG_MOT COM_OF_LOSS_T COM_RC_IN_MODE RC_MAP_KILL_SW RC_MAP_ARM_SW RC_MAP_TRANS_SW
    RC_MAP_FLTMODE RC_MAP_FLTM_BTN RC_MAP_RETURN_SW RC_MAP_LOITER_SW RC_MAP_OFFB_SW RC_MAP_ROLL RC_MAP_PITCH
    RC_MAP_THROTTLE RC_MAP_YAW RC_MAP_FAILSAFE RC_MAP_GEAR_SW RC_MAP_PARAM1 RC_MAP_PARAM2 RC_MAP_PARAM3
    RC_MAP_AUX1 RC_MAP_AUX2 RC_MAP_AUX3 RC_MAP_AUX4 RC_MAP_AUX5 RC_MAP_AUX6 RC_MAP_PAY_SW MAN_KILL_GEST_T
  )
  # Names in old versions.
  @more ~w(RC_MAP_MODE_SW RC_MAP_ACRO_SW RC_MAP_STAB_SW RC_MAP_MAN_SW RC_MAP_POSCTL_SW RC_MAP_RATT_SW)
  @kept MapSet.new(@read ++ @more)
  # Every version has these.
  @needed ~w(
    RC_MAP_KILL_SW RC_MAP_ARM_SW RC_MAP_TRANS_SW RC_MAP_PARAM1 RC_MAP_PARAM2 RC_MAP_PARAM3 RC_MAP_FAILSAFE
    RC_MAP_RETURN_SW RC_MAP_LOITER_SW RC_MAP_OFFB_SW RC_MAP_FLTMODE
  )
  @modes ~w(
    RC_MAP_FLTMODE RC_MAP_RETURN_SW RC_MAP_LOITER_SW RC_MAP_OFFB_SW RC_MAP_MODE_SW RC_MAP_ACRO_SW RC_MAP_STAB_SW
    RC_MAP_MAN_SW RC_MAP_POSCTL_SW RC_MAP_RATT_SW
  )
  @buttons "RC_MAP_FLTM_BTN"
  @sticks %{"RC_MAP_ROLL" => 1, "RC_MAP_PITCH" => 2, "RC_MAP_THROTTLE" => 3, "RC_MAP_YAW" => 4}
  @switches ~w(
    RC_MAP_KILL_SW RC_MAP_TERM_SW RC_MAP_ARM_SW RC_MAP_ENG_MOT RC_MAP_TRANS_SW RC_MAP_FAILSAFE RC_MAP_PARAM1
    RC_MAP_PARAM2 RC_MAP_PARAM3 RC_MAP_GEAR_SW RC_MAP_PAY_SW RC_MAP_AUX1 RC_MAP_AUX2 RC_MAP_AUX3 RC_MAP_AUX4
    RC_MAP_AUX5 RC_MAP_AUX6
  ) ++
              @modes

  @impl true
  def params(_kind), do: @read

  @impl true
  def keeps?(name), do: name in @kept

  @impl true
  def worked(channels) do
    last = Enum.max(for({n, us} <- channels, not Inputs.ignored?(n, us), do: n), fn -> 0 end)
    Map.filter(channels, fn {n, _us} -> n <= last end)
  end

  @impl true
  def effects(inputs, _kind, params) do
    channels = for {n, _us} <- Enum.sort(inputs.channels), effect <- channel(n, params), do: effect
    channels ++ for n <- inputs.aux, do: {"it works AUX #{n}", {:output, :payload, []}}
  end

  defp channel(n, params) do
    found =
      for(name <- @switches, params[name] == n, do: {"channel #{n} is #{text(name)} (#{name})", effect(name)}) ++
        if(button?(n, params[@buttons]),
          do: [{"channel #{n} changes the mode (#{@buttons})", {:mode, []}}],
          else: []
        )

    missing = Enum.reject(@needed, &is_map_key(params, &1))
    if missing == [] or stick?(n, params), do: found, else: found ++ [{unread(n, missing), :unknown}]
  end

  defp unread(n, [first | more]) do
    others = if more == [], do: "", else: " and others"
    "what channel #{n} switches is not known (#{first}#{others} not read from the vehicle)"
  end

  # The channels by which it is steered mostly, as long as it did not say otherwise.
  defp stick?(n, params), do: Enum.any?(@sticks, fn {name, usual} -> Map.get(params, name, usual) == n end)

  defp button?(_n, bits) when bits in [nil, 0], do: false
  defp button?(n, bits), do: Bitwise.band(Bitwise.bsr(trunc(bits), n - 1), 1) == 1

  defp effect(name) when name in ["RC_MAP_KILL_SW", "RC_MAP_TERM_SW"], do: {:command, "terminate", []}
  # It disarms as well, in the air in the modes that a pilot flies by hand.
  defp effect(name) when name in ["RC_MAP_ARM_SW", "RC_MAP_ENG_MOT"], do: {:command, "arm", [:force_disarm]}
  # It may end the flight on its wings at any speed.
  defp effect("RC_MAP_TRANS_SW"), do: {:output, :fly, [:protection]}
  defp effect("RC_MAP_FAILSAFE"), do: {:output, :protection, []}
  defp effect("RC_MAP_PARAM" <> _n), do: :parameter
  defp effect(name) when name in @modes, do: {:mode, []}
  defp effect("RC_MAP_GEAR_SW"), do: {:output, :fly, []}
  defp effect(_output), do: {:output, :payload, []}

  defp text("RC_MAP_KILL_SW"), do: "its kill switch"
  defp text("RC_MAP_TERM_SW"), do: "its switch for the end of a flight"
  defp text("RC_MAP_ARM_SW"), do: "its arming switch"
  defp text("RC_MAP_ENG_MOT"), do: "its engine's switch"
  defp text("RC_MAP_TRANS_SW"), do: "its transition switch"
  defp text("RC_MAP_FAILSAFE"), do: "the one that starts its failsafe"
  defp text("RC_MAP_PARAM" <> _n), do: "one that sets a parameter"
  defp text(name) when name in @modes, do: "one that changes the mode"
  defp text(_output), do: "an output's"
end
