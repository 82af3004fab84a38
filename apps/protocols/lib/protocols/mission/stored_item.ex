defmodule Protocols.Mission.StoredItem do
  @moduledoc """
  What a firmware keeps of an item of a plan, and returns when it is read back (`c:Protocols.Mission.Firmware.kept/3`): what each field may be then.
  """

  @type field ::
          :command
          | :frame
          | :param1
          | :param2
          | :param3
          | :param4
          | :x
          | :y
          | :z
          | :autocontinue

  @typedoc """
    * `:any` - the firmware does not keep it
    * a list - one of these values; nil is "unset"
    * `{:near, values, tolerance}` - one of these values, as rounded by the firmware
    * `{:angle, degrees, tolerance}` - this direction, with any number of turns
  """
  @type expected ::
          :any
          | [number() | nil, ...]
          | {:near, [float(), ...], tolerance :: float()}
          | {:angle, float(), tolerance :: float()}

  @typedoc "A field that is missing is kept as it was sent. Frames are those of `Protocols.Mission.Item.plain_frame/1`."
  @type t :: %{optional(field()) => expected()}

  # A 32-bit float has 24 bits; two operations on it may each cost half of the last one.
  @precision 2.4e-7

  @doc "Whether a value that was read is one that is expected."
  @spec match?(expected(), number() | nil) :: boolean()
  def match?(:any, _value), do: true
  def match?(values, value) when is_list(values), do: Enum.any?(values, &same?(&1, value))
  def match?(_number, nil), do: false
  def match?({:near, values, tolerance}, value), do: Enum.any?(values, &(abs(&1 - value) <= tolerance))
  def match?({:angle, degrees, tolerance}, value), do: turned(degrees - value) <= tolerance

  @doc "Whether a value that was read is so close to the one that was sent that it needs no remark."
  @spec same?(expected(), sent :: number() | nil, read :: number() | nil) :: boolean()
  def same?(_expected, nil, _read), do: true
  def same?(_expected, _sent, nil), do: false
  def same?({:angle, _degrees, tolerance}, sent, read), do: turned(sent - read) <= tolerance
  def same?(_expected, sent, read) when is_integer(read), do: sent == read
  def same?(_expected, sent, read), do: abs(sent - read) <= abs(sent) * @precision

  @doc "A number of which a firmware keeps so many parts per unit, cut; what a float's error could change may be either."
  @spec cut(number(), parts :: pos_integer()) :: expected()
  def cut(number, parts) do
    exact = number * parts
    error = abs(exact) * @precision
    values = Enum.uniq([trunc(exact - error) / parts, trunc(exact + error) / parts])
    {:near, values, max(1.0e-5, abs(number) * @precision)}
  end

  @doc "A number that is kept as an integer of this range, cut. One beyond it would become another one: it has to come back as it is."
  @spec whole(number(), Range.t()) :: expected()
  def whole(number, range), do: if(trunc(number) in range, do: [trunc(number)], else: [number])

  defp same?(nil, value), do: value == nil
  defp same?(_number, nil), do: false
  # Places are integers, and exact; -0.0 is 0.0.
  defp same?(a, b) when is_integer(b), do: a == b
  defp same?(a, b), do: a == b or <<a::float-32>> == <<b::float-32>>

  defp turned(degrees) do
    turn = :math.fmod(abs(degrees), 360.0)
    min(turn, 360.0 - turn)
  end
end
