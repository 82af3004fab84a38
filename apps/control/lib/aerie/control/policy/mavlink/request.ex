defmodule Aerie.Control.Policy.Mavlink.Request do
  @moduledoc """
  COMMAND_LONG, COMMAND_INT and the items of a mission, brought to one form: a command of MAV_CMD, its parameters, and
  its place.
  """

  alias MavCodec.Meaning.Commands.Numbers
  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Mavlink.Place
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @unset 0x7FFFFFFF
  @local_ned 1

  @enforce_keys [:command, :params, :path, :frame?]
  defstruct [:command, :params, :path, :frame?]

  @typedoc """
  `:params` by their number, as they came; `:path` leads to the place that the parameters 5 to 7 name; `:frame?` -
  whether the message says what its height is above.
  """
  @type t :: %__MODULE__{
          command: non_neg_integer(),
          params: %{(1..7) => term()},
          path: Intent.path(),
          frame?: boolean()
        }

  @doc "The request of a message."
  @spec of(struct(), Aerie.Control.Policy.Mavlink.vehicle()) :: t()
  def of(%M.CommandLong{} = m, vehicle) do
    place = Place.floats(m.param5, m.param6, long_height(m.param7, vehicle))
    values = {m.param5, m.param6, m.param7}
    new(m, values, known({:to, [place]}, values, vehicle))
  end

  def of(%M.CommandInt{frame: @local_ned} = m, _vehicle),
    do: new(m, {m.x, m.y, m.z}, Place.local(@local_ned, {m.x / 1.0e4, m.y / 1.0e4, m.z}))

  def of(%M.CommandInt{} = m, vehicle) do
    values = {int(m.x), int(m.y), m.z}
    new(m, values, known({:to, readings(Place.of(m), vehicle)}, {m.x, m.y, m.z}, vehicle))
  end

  def of(%M.MissionItem{} = m, vehicle), do: item(m, {m.x, m.y, m.z}, vehicle)
  def of(%M.MissionItemInt{} = m, vehicle), do: item(m, {int(m.x), int(m.y), m.z}, vehicle)

  # In a mission nothing is kept as it is.
  defp item(m, {_x, _y, z} = values, vehicle),
    do: new(m, values, if(is_number(z), do: {:to, [Place.item(m, vehicle)]}, else: missing(7, "the height")))

  # PX4 keeps what is NaN as it is. ArduPilot makes an integer of it, which may be any.
  defp known(path, {x, y, z}, vehicle) do
    cond do
      Firmware.reading(vehicle.autopilot).keeps_nan? -> path
      not is_number(z) -> missing(7, "the height")
      not is_number(x) and not is_number(y) -> missing(5, "the latitude")
      true -> path
    end
  end

  @doc "The path of a command of which a number is missing that the vehicle takes from elsewhere, or makes up."
  @spec missing(1..7, String.t()) :: Intent.path()
  def missing(index, what), do: {:unknown, "#{what} (parameter #{index}) is not a number"}

  defp new(m, {p5, p6, p7}, path) do
    params = %{1 => m.param1, 2 => m.param2, 3 => m.param3, 4 => m.param4, 5 => p5, 6 => p6, 7 => p7}
    %__MODULE__{command: m.command, params: params, path: path, frame?: not is_struct(m, M.CommandLong)}
  end

  defp long_height(metres, _vehicle) when not is_number(metres), do: :same
  defp long_height(metres, vehicle), do: {Firmware.reading(vehicle.autopilot).long_height, metres}

  defp readings(%{height: {above, metres}} = place, vehicle) when above != :msl do
    if Firmware.reading(vehicle.autopilot).ignores_frame?,
      do: [place, %{place | height: {:msl, metres}}],
      else: [place]
  end

  defp readings(place, _vehicle), do: [place]

  defp int(@unset), do: :nan
  defp int(value), do: value

  @doc "The parameter as an integer, nil if it is not one."
  @spec int(t(), 1..7) :: integer() | nil
  def int(request, index) do
    case Numbers.integer(request.params[index]) do
      {:ok, number} -> number
      :error -> nil
    end
  end

  # A parameter as a number, 0 if it is not one.
  defp number(request, index), do: Place.number(request.params[index])

  # What happens at its place, and which of its parameters say more about it.
  @sweeps for {names, sweep} <- [
                {~w(NAV_LOITER_UNLIM NAV_LOITER_TIME DO_REPOSITION), {:stay, 3}},
                {~w(NAV_LOITER_TURNS), {:turns, 3}},
                {~w(NAV_LOITER_TO_ALT), {:stay, 2}},
                {~w(DO_ORBIT DO_FIGURE_EIGHT SET_GUIDED_SUBMODE_CIRCLE), {:turns, 1}},
                {~w(NAV_WAYPOINT), {:pass, 2, 3}},
                {~w(NAV_SPLINE_WAYPOINT NAV_ARC_WAYPOINT NAV_PATHPLANNING), :curve},
                {~w(NAV_LAND), {:land, 1}},
                {~w(NAV_VTOL_LAND), {:land, 3}},
                {~w(NAV_TAKEOFF NAV_VTOL_TAKEOFF), :takeoff}
              ],
              name <- names,
              into: %{},
              do: {MavCmd.value(:"MAV_CMD_#{name}"), sweep}

  @doc "What happens at its place."
  @spec sweep(t()) :: Intent.sweep()
  def sweep(request) do
    case Map.get(@sweeps, request.command, {:stay, nil}) do
      {:pass, acceptance, beyond} -> {:pass, abs(number(request, acceptance)), abs(number(request, beyond))}
      {kind, index} when is_integer(index) -> {kind, abs(number(request, index))}
      other -> other
    end
  end

  @doc "The path to the height in its first parameter; 0 leaves it to the vehicle."
  @spec climb(t()) :: Intent.path()
  def climb(request) do
    case request.params[1] do
      metres when metres == 0 -> :none
      metres when is_number(metres) -> {:level, {:home, metres}}
      _nan -> missing(1, "the height")
    end
  end

  @doc "The first place that it names."
  @spec place(t()) :: Intent.place()
  def place(%{path: {:to, [place | _]}}), do: place
  def place(_local), do: %{lat: nil, lon: nil, height: :same}
end
