defmodule MavCodec.Test.Msp do
  @moduledoc "Generators of MSP frames and payloads."

  alias MavCodec.Msp.{Field, Frame}

  @doc "A generator whose values are made of another one's."
  def let(type, fun), do: :proper_types.bind(type, fun, false)

  @doc "Frames of any form and direction."
  def frame do
    let({one_of([:v1, :v2, :v2_over_v1]), one_of([:request, :reply, :error]), payload()}, fn {form, direction,
                                                                                              payload} ->
      let({id(form), flags(form)}, fn {id, flags} ->
        %Frame{form: form, direction: direction, id: id, flags: flags, payload: payload}
      end)
    end)
  end

  defp id(:v1), do: range(0, 254)
  defp id(_v2), do: range(0, 0xFFFF)
  defp flags(:v1), do: 0
  defp flags(_v2), do: range(0, 255)

  # Around the sizes at which the form of the frame changes, and full of what begins a frame.
  defp payload do
    let(one_of([range(0, 40), range(245, 260), 300]), fn size ->
      binary(:proper_types.vector(size, byte()))
    end)
  end

  defp byte, do: :proper_types.frequency([{3, one_of([0xFF, 6 | ~c"$MX<>!"])}, {2, range(0, 255)}])

  @doc "Bytes that are no frames, but look like the beginnings of some."
  def noise, do: binary(:proper_types.list(byte()))

  @doc "Any bytes."
  def bytes, do: binary(:proper_types.list(range(0, 255)))

  @doc "Values of all fields of a layout that a version has."
  def values(layout, version) do
    types = for part <- layout, type = part(part, layout, version), do: type
    let(types, fn lists -> Map.new(List.flatten(lists)) end)
  end

  defp part({:optional, inner}, _layout, version),
    do: one_of([[], let(values(inner, version), &Map.to_list/1)])

  defp part({:list, key, count, inner}, _layout, version) do
    length =
      cond do
        not Enum.any?(inner, &Field.in?(&1, version)) -> 0
        is_integer(count) -> count
        true -> range(0, 5)
      end

    let(length, fn n -> let(:proper_types.vector(n, values(inner, version)), &[{key, &1}]) end)
  end

  defp part(%Field{key: key, type: type} = field, layout, version) do
    cond do
      not Field.in?(field, version) -> nil
      # It counts the entries of a list.
      Enum.any?(layout, &match?({:list, _, ^key, _}, &1)) -> nil
      true -> let(value(type), &[{key, &1}])
    end
  end

  defp value(:u8), do: range(0, 0xFF)
  defp value(:i8), do: range(-0x80, 0x7F)
  defp value(:u16), do: range(0, 0xFFFF)
  defp value(:i16), do: range(-0x8000, 0x7FFF)
  defp value(:u32), do: range(0, 0xFFFFFFFF)
  defp value(:i32), do: range(-0x80000000, 0x7FFFFFFF)
  defp value(:u64), do: range(0, 0xFFFFFFFFFFFFFFFF)
  defp value({_kind, size}), do: binary(:proper_types.vector(size, range(0, 255)))
  defp value(:zstr), do: binary(:proper_types.list(range(1, 255)))
  defp value(_text), do: binary(:proper_types.list(range(0, 255)))

  defp one_of(types), do: :proper_types.oneof(types)
  defp range(low, high), do: :proper_types.range(low, high)
  defp binary(type), do: let(type, &:binary.list_to_bin/1)
end
