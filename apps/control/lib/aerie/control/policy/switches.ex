defmodule Aerie.Control.Policy.Switches do
  @moduledoc """
  What channels of the remote control and buttons do that an override or a joystick works: by the vehicle's parameters, as far as they are
  known (`Aerie.Vehicle.Services.Switches`).

  ArduPilot: the mode channel (FLTMODE_CH, MODE_CH) has six positions with a mode each (`RC_Channel::read_6pos_switch`), the others a function
  (RCn_OPTION) that a switch works in its low, middle and high position; a submarine's buttons have functions (BTNn_FUNCTION), others' none.
  PX4: the channels that RC_MAP_* names; which position means what depends on their calibration, so they may mean anything.
  """

  alias Aerie.Control.Policy.{Context, Intent}
  alias Aerie.Control.Policy.Mavlink.AuxFunctions
  alias Aerie.Vehicle.Protocol.Modes

  # The sticks, unless somebody has mapped them otherwise.
  @sticks 4
  # ArduPilot takes no notice of a pulse beyond these; each band ends before its number.
  @pulse 801..2199
  @bands [1231, 1361, 1491, 1621, 1750]
  @low 1200
  @high 1800
  @options 16

  @px4_modes ~w(RC_MAP_FLTMODE RC_MAP_RETURN_SW RC_MAP_LOITER_SW RC_MAP_OFFB_SW)
  @px4_buttons "RC_MAP_FLTM_BTN"

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
  @own [:force_disarm, :terminate, :protection]

  @doc "The modes that may be entered by it, by their names, or what would have to be known."
  @spec modes(Intent.t(), Context.t()) :: {:ok, [String.t()]} | {:unknown, String.t()}
  def modes(%{switches: nil}, _context), do: {:ok, []}
  def modes(%{switches: :unknown}, _context), do: {:unknown, "which channels it works cannot be read"}

  def modes(%{switches: %{channels: channels, buttons: buttons}}, context) do
    found =
      for({n, us} <- Enum.sort(channels), do: channel(n, us, context)) ++
        for n <- buttons, do: button(n, context)

    Enum.find(
      found,
      {:ok, for({:ok, names} <- found, name <- names, uniq: true, do: name)},
      &match?({:unknown, _}, &1)
    )
  end

  @doc "Permissions that it needs, because a channel ends a flight or takes away a protection."
  @spec permissions(Intent.t(), Context.t()) :: [atom()]
  def permissions(%{switches: %{channels: channels}}, %{autopilot: :ardupilot} = context) do
    for {n, us} <- channels,
        {:ok, %{} = facts} <- [option(n, us, context)],
        permission <- [facts.permission | facts.also],
        permission in @own,
        uniq: true,
        do: permission
  end

  def permissions(_facts, _context), do: []

  defp channel(_n, us, %{autopilot: :ardupilot}) when us not in @pulse, do: {:ok, []}

  defp channel(n, us, %{autopilot: :ardupilot} = context) do
    with {:ok, by_switch} <- mode_switch(n, us, context),
         {:ok, option} <- option(n, us, context),
         do: {:ok, by_switch ++ if(option && option.mode, do: [option.mode], else: [])}
  end

  defp channel(n, _us, %{autopilot: :px4, params: params}) do
    cond do
      Enum.any?(@px4_modes, &(params[&1] == n)) or params[@px4_buttons] not in [nil, 0] ->
        {:unknown, "channel #{n} may change the mode"}

      Enum.all?(@px4_modes, &is_map_key(params, &1)) ->
        {:ok, []}

      true ->
        beyond_sticks(n, "which channels change the mode (RC_MAP_*) is not known")
    end
  end

  defp channel(n, _us, _context), do: beyond_sticks(n, "what channel #{n} switches is not known")

  defp mode_switch(_n, _us, %{vehicle_type: "sub"}), do: {:ok, []}

  defp mode_switch(n, us, %{vehicle_type: kind, params: params} = context) do
    {channel, slot} = if kind in ["rover", "boat"], do: {"MODE_CH", "MODE"}, else: {"FLTMODE_CH", "FLTMODE"}

    case params do
      %{^channel => known} when known == n -> slot(slot <> "#{position(us)}", context)
      %{^channel => _another} -> {:ok, []}
      _unknown -> beyond_sticks(n, "which channel changes the mode (#{channel}) is not known")
    end
  end

  defp slot(name, %{params: params} = context) do
    with number when is_number(number) <- params[name],
         [_ | _] = modes <- Modes.asked(:ardupilot, context.vehicle_type, 1, trunc(number)) do
      {:ok, modes}
    else
      _unknown -> {:unknown, "which mode its switch then chooses (#{name}) is not known"}
    end
  end

  # The facts of the function of a channel, nil for none.
  defp option(n, _us, _context) when n > @options, do: {:ok, nil}

  defp option(n, us, %{params: params}) do
    case params["RC#{n}_OPTION"] do
      none when none == 0 ->
        {:ok, nil}

      function when is_number(function) ->
        {:ok, AuxFunctions.facts(trunc(function), level(us))}

      nil ->
        with {:ok, []} <- beyond_sticks(n, "what channel #{n} switches (RC#{n}_OPTION) is not known"),
             do: {:ok, nil}
    end
  end

  defp position(us), do: Enum.find_index(@bands ++ [:infinity], &(us < &1)) + 1

  defp level(us) when us < @low, do: 0
  defp level(us) when us > @high, do: 2
  defp level(_middle), do: 1

  defp beyond_sticks(n, _why) when n <= @sticks, do: {:ok, []}
  defp beyond_sticks(_n, why), do: {:unknown, why}

  # It may be pressed with the shift button, too.
  defp button(n, %{autopilot: :ardupilot, vehicle_type: "sub", params: params}) do
    functions = for name <- ["BTN#{n}_FUNCTION", "BTN#{n}_SFUNCTION"], do: params[name]

    if nil in functions,
      do: {:unknown, "what button #{n} does (BTN#{n}_FUNCTION, BTN#{n}_SFUNCTION) is not known"},
      else: {:ok, for(function <- functions, mode = @sub_modes[trunc(function)], do: mode)}
  end

  defp button(_n, _no_functions), do: {:ok, []}
end
