defmodule Circuits.UART.Test.Generators do
  @moduledoc "PropEr types that several properties use."

  @doc "Bytes in which separators are frequent."
  def line_noise do
    byte = :proper_types.oneof([?\n, ?\r, ?a, ?b, :proper_types.byte()])
    map(:proper_types.list(byte), &:erlang.list_to_binary/1)
  end

  @doc "Where to cut: lengths of pieces."
  def splits, do: :proper_types.list(:proper_types.integer(0, 7))

  @doc "The pieces; what the lengths leave over is the last one."
  def cut(bytes, []), do: [bytes]
  def cut(bytes, [n | splits]) when n >= byte_size(bytes), do: cut(bytes, splits)

  def cut(bytes, [n | splits]) do
    <<piece::binary-size(^n), rest::binary>> = bytes
    [piece | cut(rest, splits)]
  end

  @doc "A type of what `fun` makes of the values of another one."
  def map(type, fun), do: :proper_types.bind(type, fun, false)
end
