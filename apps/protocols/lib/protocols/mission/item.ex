defmodule Protocols.Mission.Item do
  @moduledoc """
  One item of a mission, a fence or a list of rally points, as MISSION_ITEM_INT carries it. Its number is its index in the
  list.
  """

  alias MavCodec.Enums.{MavCmd, MavFrame}
  alias MavCodec.Meaning
  alias MavCodec.Messages, as: M

  @unset 0x7FFFFFFF
  @mission MavFrame.value(:MAV_FRAME_MISSION)
  # LOCAL_*, BODY_* and reserved ones.
  @local for {name, value} <- MavFrame.all(),
             not String.starts_with?(to_string(name), ["MAV_FRAME_GLOBAL", "MAV_FRAME_MISSION"]),
             do: value

  @enforce_keys [:command, :frame]
  defstruct [:command, :frame, params: {0.0, 0.0, 0.0, 0.0}, x: 0, y: 0, z: 0.0, autocontinue: 1]

  @typedoc """
    * `:command` - MAV_CMD; `:frame` - MAV_FRAME
    * `:params` - the first four; nil is "unset", NaN on the wire
    * `:x`, `:y` - latitude and longitude in 1e-7 degrees, or metres times 1e4 in a local frame; nil is "unset". Parameters 5 and 6 as
      they are if the item has no place (`place?/2`)
    * `:z` - metres, or parameter 7
    * `:autocontinue` - 0 or 1
  """
  @type t :: %__MODULE__{
          command: 0..65_535,
          frame: 0..255,
          params: {float() | nil, float() | nil, float() | nil, float() | nil},
          x: integer() | nil,
          y: integer() | nil,
          z: float() | nil,
          autocontinue: 0..1
        }

  @doc "Whether positions in a frame (MAV_FRAME) are in metres."
  @spec local?(integer()) :: boolean()
  def local?(frame), do: frame in @local

  @doc """
  Whether `x` and `y` of an item are a place. Its command decides, whatever the frame; the frame MISSION has no places.
  """
  @spec place?(command :: integer(), frame :: integer()) :: boolean()
  def place?(_command, @mission), do: false
  def place?(command, _frame), do: MavCmd.location?(command) != false

  @doc "Whether the vehicle flies to the place of an item. Both firmwares take 0, 0 for the present position."
  @spec flown?(t()) :: boolean()
  def flown?(%{x: x, y: y, command: command}),
    do: is_integer(x) and is_integer(y) and {x, y} != {0, 0} and Meaning.Commands.place?(command)

  @doc "Whether an item whose command has a place says how high that is, whatever its frame."
  @spec height?(t()) :: boolean()
  def height?(%{z: z}) when z != nil, do: true

  def height?(item) do
    case MavCmd.location?(item.command) do
      nil -> item.x == nil and item.y == nil
      place? -> not place?
    end
  end

  @doc "The message for an item with its number (W5). The first item of a mission is the current one."
  @spec message(t(), non_neg_integer(), 0..2, {0..255, 0..255}) :: struct()
  def message(item, seq, mission_type, {system, component}) do
    {p1, p2, p3, p4} = item.params

    %M.MissionItemInt{
      target_system: system,
      target_component: component,
      seq: seq,
      mission_type: mission_type,
      frame: item.frame,
      command: item.command,
      current: if(seq == 0 and mission_type == 0, do: 1, else: 0),
      autocontinue: item.autocontinue,
      param1: float(p1),
      param2: float(p2),
      param3: float(p3),
      param4: float(p4),
      x: item.x || @unset,
      y: item.y || @unset,
      z: float(item.z)
    }
  end

  @doc "The item of a message. `current` is not part of it (W8)."
  @spec read(struct()) :: t()
  def read(%M.MissionItemInt{} = m) do
    %__MODULE__{
      command: m.command,
      frame: m.frame,
      params: {number(m.param1), number(m.param2), number(m.param3), number(m.param4)},
      x: coordinate(m.x),
      y: coordinate(m.y),
      z: number(m.z),
      autocontinue: min(m.autocontinue, 1)
    }
  end

  @doc "The item with its floats as the wire carries them (W8)."
  @spec rounded(t()) :: t()
  def rounded(item) do
    params = item.params |> Tuple.to_list() |> Enum.map(&float32/1) |> List.to_tuple()
    %{item | params: params, z: float32(item.z)}
  end

  @doc "A number as a 32-bit float carries it; nil stays nil. The number must fit (`fits?/1`)."
  @spec float32(number() | nil) :: float() | nil
  def float32(nil), do: nil

  def float32(number) do
    <<rounded::float-32>> = <<number::float-32>>
    # -0.0 and 0.0 are the same value.
    rounded + 0.0
  end

  @doc "Whether a 32-bit float can carry a number."
  @spec fits?(number()) :: boolean()
  def fits?(number), do: abs(number) <= 3.4028234e38

  @doc "The frame without _INT in its name that means the same: in an item with integers both are equal (W5)."
  @spec plain_frame(integer()) :: integer()
  def plain_frame(5), do: 0
  def plain_frame(6), do: 3
  def plain_frame(11), do: 10
  def plain_frame(frame), do: frame

  defp float(nil), do: :nan
  defp float(number), do: number

  defp number(value) when is_float(value), do: value
  defp number(_nan_or_infinity), do: nil

  defp coordinate(@unset), do: nil
  defp coordinate(value), do: value
end
