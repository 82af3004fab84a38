defmodule MavCodec.Msp.Field do
  @moduledoc """
  A field of an MSP payload. Values are the numbers on the wire; `value/2` applies the scale.

  - `type`: `:u8` to `:u64`, `:i8` to `:i32`; `{:text, bytes}`, `{:raw, bytes}`; `:pstr`: its length in one byte, then
    the text; `:zstr`: ends with a NUL; `:strrest`, `:rest`: text or bytes to the end
  - `unit`: nil if it is a plain number
  - `since`, `until`: the first version that has it, the first that no longer has it
  """

  alias MavCodec.Msp.Message

  @enforce_keys [:key, :type]
  defstruct [:key, :type, :unit, :since, :until, scale: 1]

  @type type ::
          :u8
          | :u16
          | :u32
          | :u64
          | :i8
          | :i16
          | :i32
          | :pstr
          | :zstr
          | :strrest
          | :rest
          | {:text | :raw, pos_integer}

  @type t :: %__MODULE__{
          key: atom,
          type: type,
          unit: String.t() | nil,
          scale: number,
          since: Message.version() | nil,
          until: Message.version() | nil
        }

  @typedoc "`{:list, key, count, layout}`: `count` is a number, the key of a field before it, or `:rest`; `{:optional, layout}`: all or nothing."
  @type layout :: [
          t | {:list, key :: atom, count :: pos_integer | atom, layout} | {:optional, layout}
        ]

  @doc "Whether a version has the field; an unknown one (nil) may have every field that none has lost."
  @spec in?(t, Message.version() | nil) :: boolean
  def in?(%__MODULE__{until: until}, nil), do: until == nil

  def in?(%__MODULE__{since: since, until: until}, version),
    do: (since == nil or version >= since) and (until == nil or version < until)

  @doc """
  A number of the wire in the unit of its field.

      iex> {:ok, attitude} = MavCodec.Msp.Messages.fetch(:betaflight, "ATTITUDE")
      iex> MavCodec.Msp.Field.value(hd(attitude.reply), -199)
      -19.9
  """
  @spec value(t, number) :: number
  def value(%__MODULE__{scale: 1}, number), do: number
  # Division by a power of ten gives the nearest float, multiplication by its inverse does not.
  def value(%__MODULE__{scale: scale}, number) when scale < 1, do: number / round(1 / scale)
  def value(%__MODULE__{scale: scale}, number), do: number * scale
end
