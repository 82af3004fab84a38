defmodule SimVehicle.Services.Command do
  @moduledoc """
  A COMMAND_LONG, a COMMAND_INT or an order of the demo's pilot in one shape.

  `params` are the seven floats of COMMAND_LONG; a COMMAND_INT has its position in `lat`/`lon` (degrees x 1e7) and
  `alt`. Values that are not given (NaN, INT32_MAX) are nil after `location/1` and `p/3`.
  """

  alias MavCodec.Messages, as: M
  alias SimVehicle.Real32

  @frame_global 0
  @no_position 2_147_483_647

  defstruct id: 0,
            params: {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0},
            int?: false,
            frame: @frame_global,
            x: nil,
            y: nil,
            confirmation: 0,
            source: {0, 0},
            target: {0, 0}

  @typedoc "`source`: system and component that sent it, or `:pilot` for the demo's own script."
  @type t :: %__MODULE__{}

  @doc "The command in a message, nil for any other message."
  @spec from(struct, {integer, integer}) :: t | nil
  def from(%M.CommandLong{} = m, source) do
    %__MODULE__{
      id: m.command,
      params: {m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7},
      confirmation: m.confirmation,
      source: source,
      target: {m.target_system, m.target_component}
    }
  end

  def from(%M.CommandInt{} = m, source) do
    %__MODULE__{
      id: m.command,
      params: {m.param1, m.param2, m.param3, m.param4, 0.0, 0.0, m.z},
      int?: true,
      frame: m.frame,
      x: m.x,
      y: m.y,
      source: source,
      target: {m.target_system, m.target_component}
    }
  end

  def from(_message, _source), do: nil

  @doc "An order of the vehicle's own pilot; nobody is sent its acknowledgement."
  @spec pilot(non_neg_integer, [number | atom]) :: t
  def pilot(id, params) do
    padded = Enum.take(params ++ List.duplicate(0.0, 7), 7)
    %__MODULE__{id: id, params: List.to_tuple(padded), source: :pilot}
  end

  @doc "Parameter 1..7 as a number, `default` when it is not one (NaN = unchanged, rule C9)."
  @spec p(t, 1..7, number | nil) :: number | nil
  def p(command, n, default \\ 0.0), do: Real32.number(elem(command.params, n - 1)) || default

  @doc "Latitude and longitude in degrees x 1e7 and altitude in metres; nil where not given."
  @spec location(t) :: {integer | nil, integer | nil, number | nil}
  def location(%{int?: true} = c), do: {coordinate(c.x), coordinate(c.y), p(c, 7, nil)}
  def location(c), do: {degrees(p(c, 5, nil)), degrees(p(c, 6, nil)), p(c, 7, nil)}

  defp coordinate(@no_position), do: nil
  defp coordinate(value), do: value

  defp degrees(nil), do: nil
  # Beyond what fits in 32 bits the firmware's cast is undefined; here it is cut off.
  defp degrees(value), do: (value * 1.0e7) |> max(-2.147e9) |> min(2.147e9) |> round()
end
