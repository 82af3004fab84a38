defmodule Aerie.Vehicle.Firmware.Ardupilot.Inputs do
  @moduledoc """
  ArduPilot's channels and buttons: the mode channel (FLTMODE_CH, MODE_CH) has six positions with a mode each
  (`RC_Channel::read_6pos_switch`), the others a function (RCn_OPTION) that a switch works in its low, middle and high
  position; a submarine's buttons have functions (BTNn_FUNCTION), others' none. The sticks are those of RCMAP_*, a
  submarine's its first six channels.
  """

  @behaviour Aerie.Vehicle.Firmware.Inputs

  alias Aerie.Vehicle.Firmware.Ardupilot.Modes
  alias Aerie.Vehicle.Firmware.Inputs

  slots = fn name -> for n <- 1..6, do: "#{name}#{n}" end
  options = for n <- 1..16, do: "RC#{n}_OPTION"
  sticks = ~w(RCMAP_ROLL RCMAP_PITCH RCMAP_THROTTLE RCMAP_YAW)
  overrides = ~w(RC_OVERRIDE_TIME RC_OPTIONS)

  @flying ["FLTMODE_CH", "GUID_TIMEOUT"] ++
            overrides ++
            slots.("FLTMODE") ++ Enum.drop(options, 4) ++ sticks ++ Enum.take(options, 4) ++ ["TUNE"]
  @driving ["MODE_CH"] ++
             overrides ++ slots.("MODE") ++ Enum.drop(options, 4) ++ sticks ++ Enum.take(options, 4)
  @diving overrides ++ for(n <- 0..31, end_ <- ~w(FUNCTION SFUNCTION), do: "BTN#{n}_#{end_}") ++ options
  @kept MapSet.new(@flying ++ @driving ++ @diving)

  @sticks %{"RCMAP_ROLL" => 1, "RCMAP_PITCH" => 2, "RCMAP_THROTTLE" => 3, "RCMAP_YAW" => 4}
  @axes %{roll: "RCMAP_ROLL", pitch: "RCMAP_PITCH", throttle: "RCMAP_THROTTLE", yaw: "RCMAP_YAW"}
  # ArduPilot takes no notice of a pulse beyond these; each band ends before its number.
  @pulse 801..2199
  @bands [1231, 1361, 1491, 1621, 1750]
  @low 1200
  @high 1800
  @channels 16
  # Channels 9 and following are given back by it, the others by 0.
  @released 65_534
  @tuning 6

  # Functions of a submarine's buttons, as its firmware numbers them.
  @sub_modes %{
    5 => "MANUAL",
    6 => "STABILIZE",
    7 => "ALT_HOLD",
    8 => "POSHOLD",
    9 => "AUTO",
    10 => "CIRCLE",
    11 => "GUIDED",
    12 => "ACRO",
    13 => "SURFTRAK"
  }
  @sub_arms [2, 3]
  @sub_disarms 4
  @sub_scripts 108..111
  # Lights, cameras, gains, relays, servos.
  @sub_outputs 14..107

  @impl true
  def params(kind) when kind in ["rover", "boat"], do: @driving
  def params("sub"), do: @diving
  def params(_kind), do: @flying

  @impl true
  def keeps?(name), do: name in @kept

  @impl true
  def worked(channels), do: Map.filter(channels, fn {n, us} -> overridden?(n, us) end)

  @impl true
  def effects(inputs, kind, params) do
    axes = for {axis, value} when value != nil <- inputs.axes, n <- axis(axis, params), do: {n, :any}

    for({n, us} <- Enum.sort(inputs.channels) ++ axes, effect <- channel(n, us, kind, params), do: effect) ++
      for(n <- inputs.buttons, effect <- button(n, kind, params), do: effect) ++
      for n <- inputs.aux, kind in ["sub", "unknown", nil], do: {"what AUX #{n} does is not known", :unknown}
  end

  defp overridden?(n, us), do: not Inputs.ignored?(n, us) and us != 0 and not (n > 8 and us == @released)

  # The channels that an axis of a joystick works.
  defp axis(axis, params),
    do: for(n when is_number(n) <- [params[@axes[axis]] || @sticks[@axes[axis]]], do: trunc(n))

  defp channel(n, us, _kind, _params) when n > @channels or (is_integer(us) and us not in @pulse), do: []

  defp channel(n, us, kind, params),
    do: mode_switch(n, us, kind, params) ++ option(n, us, kind, params) ++ tuning(n, params)

  defp mode_switch(_n, _us, "sub", _params), do: []

  defp mode_switch(n, us, kind, params) do
    {channel, slot} = if kind in ["rover", "boat"], do: {"MODE_CH", "MODE"}, else: {"FLTMODE_CH", "FLTMODE"}

    case params do
      %{^channel => known} when known == n ->
        slot(n, slot, us, kind, params)

      %{^channel => _another} ->
        []

      _unknown ->
        beyond_sticks(
          n,
          kind,
          params,
          "whether channel #{n} changes the mode is not known (#{channel} not read from the vehicle)"
        )
    end
  end

  defp slot(n, _slot, :any, _kind, _params), do: [{"channel #{n} changes the mode", {:mode, []}}]

  defp slot(n, slot, us, kind, params) do
    name = "#{slot}#{position(us)}"

    with number when is_number(number) <- params[name],
         nil <- Modes.wrong(trunc(number)) do
      [{"channel #{n} changes the mode (#{name})", {:mode, Modes.asked(kind, 1, trunc(number))}}]
    else
      _unknown ->
        [
          {"which mode channel #{n} then chooses is not known (#{name} not read from the vehicle)",
           {:mode, []}}
        ]
    end
  end

  defp option(n, us, kind, params) do
    case params["RC#{n}_OPTION"] do
      none when none == 0 ->
        []

      function when is_number(function) ->
        function = trunc(function)

        for level <- levels(us),
            do: {"channel #{n} works the function #{function} (RC#{n}_OPTION)", {:function, function, level}}

      nil ->
        beyond_sticks(
          n,
          kind,
          params,
          "what channel #{n} switches is not known (RC#{n}_OPTION not read from the vehicle)"
        )
    end
  end

  # A copter's parameter that a knob turns.
  defp tuning(@tuning, %{"TUNE" => parameter}) when parameter != 0,
    do: [{"channel #{@tuning} sets a parameter (TUNE)", :parameter}]

  defp tuning(_n, _params), do: []

  defp position(us), do: Enum.find_index(@bands ++ [:infinity], &(us < &1)) + 1

  defp levels(:any), do: [0, 1, 2]
  defp levels(us) when us < @low, do: [0]
  defp levels(us) when us > @high, do: [2]
  defp levels(_middle), do: [1]

  defp beyond_sticks(n, kind, params, why), do: if(stick?(n, kind, params), do: [], else: [{why, :unknown}])

  defp stick?(n, "sub", _params), do: n <= 6

  defp stick?(n, _kind, params),
    do: Enum.any?(@sticks, fn {name, usual} -> Map.get(params, name, usual) == n end)

  # It may be pressed with the shift button as well.
  defp button(n, "sub", params) do
    names = ["BTN#{n}_FUNCTION", "BTN#{n}_SFUNCTION"]

    if Enum.all?(names, &is_map_key(params, &1)),
      do:
        for(
          name <- names,
          params[name] != 0,
          do: {"button #{n} works #{name}", function(trunc(params[name]))}
        ),
      else: [
        {"what button #{n} does is not known (#{Enum.join(names, ", ")} not read from the vehicle)", :unknown}
      ]
  end

  defp button(n, kind, _params) when kind in [nil, "unknown"],
    do: [{"what button #{n} does is not known", :unknown}]

  defp button(_n, _no_functions, _params), do: []

  defp function(n) when is_map_key(@sub_modes, n), do: {:mode, [@sub_modes[n]]}
  defp function(n) when n in @sub_arms, do: {:command, "arm", []}
  defp function(@sub_disarms), do: {:command, "disarm", []}
  # The shift button itself.
  defp function(1), do: {:command, "manual_control", []}
  defp function(n) when n in @sub_outputs, do: {:output, :payload, []}
  defp function(n) when n in @sub_scripts, do: {:output, :maintain, []}
  defp function(_unlisted), do: :unknown
end
