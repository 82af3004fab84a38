defmodule Aerie.Control.Policy.Switches.Ardupilot do
  @moduledoc """
  ArduPilot's channels and buttons: the mode channel (FLTMODE_CH, MODE_CH) has six positions with a mode each
  (`RC_Channel::read_6pos_switch`), the
  others a function (RCn_OPTION) that a switch works in its low, middle and high position; a submarine's buttons have
  functions (BTNn_FUNCTION), others'
  none. The sticks are those of RCMAP_*, a submarine's its first six channels.
  """

  alias Aerie.Control.Policy.{Context, Intent, Switches}
  alias Aerie.Control.Policy.Mavlink.AuxFunctions
  alias Aerie.Vehicle.Firmware.Modes

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

  @doc "The channels that an override works."
  @spec worked(%{pos_integer() => non_neg_integer()}) :: %{pos_integer() => non_neg_integer()}
  def worked(channels), do: Map.filter(channels, fn {n, us} -> overridden?(n, us) end)

  @doc "What an override, of these channels, or a joystick does."
  @spec effects(map(), Context.t()) :: [Switches.effect()]
  def effects(switches, context) do
    axes = for {axis, value} when value != nil <- switches.axes, n <- axis(axis, context), do: {n, :any}

    for({n, us} <- Enum.sort(switches.channels) ++ axes, effect <- channel(n, us, context), do: effect) ++
      for(n <- switches.buttons, effect <- button(n, context), do: effect) ++
      for n <- switches.aux,
          context.vehicle_type in ["sub", "unknown", nil],
          do: {"what AUX #{n} does is not known", :unknown}
  end

  defp overridden?(n, us), do: not Switches.ignored?(n, us) and us != 0 and not (n > 8 and us == @released)

  # The channels that an axis of a joystick works.
  defp axis(axis, %{params: params}),
    do: for(n when is_number(n) <- [params[@axes[axis]] || @sticks[@axes[axis]]], do: trunc(n))

  defp channel(n, us, _context) when n > @channels or (is_integer(us) and us not in @pulse), do: []

  defp channel(n, us, context),
    do: mode_switch(n, us, context) ++ option(n, us, context) ++ tuning(n, context)

  defp mode_switch(_n, _us, %{vehicle_type: "sub"}), do: []

  defp mode_switch(n, us, %{vehicle_type: kind, params: params} = context) do
    {channel, slot} = if kind in ["rover", "boat"], do: {"MODE_CH", "MODE"}, else: {"FLTMODE_CH", "FLTMODE"}

    case params do
      %{^channel => known} when known == n ->
        slot(n, slot, us, context)

      %{^channel => _another} ->
        []

      _unknown ->
        beyond_sticks(
          n,
          context,
          "whether channel #{n} changes the mode is not known (#{channel} not read from the vehicle)"
        )
    end
  end

  defp slot(n, _slot, :any, _context),
    do: [{"channel #{n} changes the mode", Intent.named("set_mode", implies: ["takeoff"])}]

  defp slot(n, slot, us, %{params: params} = context) do
    name = "#{slot}#{position(us)}"

    with number when is_number(number) <- params[name],
         [mode | others] <- Modes.asked(:ardupilot, context.vehicle_type, 1, trunc(number)) do
      [{"channel #{n} changes the mode (#{name})", Intent.named("set_mode", mode: mode, modes: others)}]
    else
      _unknown ->
        [
          {"which mode channel #{n} then chooses is not known (#{name} not read from the vehicle)",
           Intent.named("set_mode", implies: ["takeoff"])}
        ]
    end
  end

  defp option(n, us, %{params: params} = context) do
    case params["RC#{n}_OPTION"] do
      none when none == 0 ->
        []

      function when is_number(function) ->
        function = trunc(function)

        for level <- levels(us),
            do:
              {"channel #{n} works the function #{function} (RC#{n}_OPTION)",
               AuxFunctions.facts(function, level)}

      nil ->
        beyond_sticks(
          n,
          context,
          "what channel #{n} switches is not known (RC#{n}_OPTION not read from the vehicle)"
        )
    end
  end

  # A copter's parameter that a knob turns.
  defp tuning(@tuning, %{params: %{"TUNE" => parameter}}) when parameter != 0,
    do: [{"channel #{@tuning} sets a parameter (TUNE)", Intent.set_parameters([nil])}]

  defp tuning(_n, _context), do: []

  defp position(us), do: Enum.find_index(@bands ++ [:infinity], &(us < &1)) + 1

  defp levels(:any), do: [0, 1, 2]
  defp levels(us) when us < @low, do: [0]
  defp levels(us) when us > @high, do: [2]
  defp levels(_middle), do: [1]

  defp beyond_sticks(n, context, why), do: if(stick?(n, context), do: [], else: [{why, :unknown}])

  defp stick?(n, %{vehicle_type: "sub"}), do: n <= 6

  defp stick?(n, %{params: params}),
    do: Enum.any?(@sticks, fn {name, usual} -> Map.get(params, name, usual) == n end)

  # It may be pressed with the shift button as well.
  defp button(n, %{vehicle_type: "sub", params: params}) do
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

  defp button(n, %{vehicle_type: kind}) when kind in [nil, "unknown"],
    do: [{"what button #{n} does is not known", :unknown}]

  defp button(_n, _no_functions), do: []

  defp function(n) when is_map_key(@sub_modes, n), do: Intent.named("set_mode", mode: @sub_modes[n])
  defp function(n) when n in @sub_arms, do: Intent.named("arm")
  defp function(@sub_disarms), do: Intent.named("disarm")
  # The shift button itself.
  defp function(1), do: Intent.named("manual_control")
  defp function(n) when n in @sub_outputs, do: %Intent{type: "aux_function", permission: :payload}
  defp function(n) when n in @sub_scripts, do: %Intent{type: "aux_function", permission: :maintain}
  defp function(_unlisted), do: :unknown
end
