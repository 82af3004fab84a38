defmodule MavCodec.Msp.Payload do
  @moduledoc """
  Payloads of MSP by their layout: bytes to a map and back.

  Firmware only ever appends fields, so a payload may end between any two of them: what is not there is not in the map. Bytes behind
  the known fields are in `:tail` and are written back. A map that was read is written as the same bytes.
  """

  alias MavCodec.Msp.{Field, Message}

  @type values :: %{optional(atom) => integer | binary | [values]}
  @type error :: String.t()

  @doc """
  The values of a payload for a version, or nil if that is unknown.

      iex> {:ok, message} = MavCodec.Msp.Messages.fetch(:betaflight, "ALTITUDE")
      iex> MavCodec.Msp.Payload.decode(message.reply, <<250::32-little, -3::16-little>>, {1, 46})
      {:ok, %{altitude: 250, vario: -3}}
      iex> MavCodec.Msp.Payload.decode(message.reply, <<250::32-little, 3>>, {1, 46})
      {:error, "it ends inside vario"}
  """
  @spec decode(Field.layout(), binary, Message.version() | nil) :: {:ok, values} | {:error, error}
  def decode(layout, payload, version) do
    case read(layout, payload, version, %{}, :outer) do
      {:ok, values, ""} -> {:ok, values}
      {:ok, values, tail} -> {:ok, Map.put(values, :tail, tail)}
      {:error, _why} = error -> error
    end
  end

  # `place`: an entry of a list, and what is optional, is there as a whole.
  defp read([], rest, _version, values, _place), do: {:ok, values, rest}

  defp read([{:optional, _layout} | more], "", version, values, place),
    do: read(more, "", version, values, place)

  defp read([{:optional, layout} | more], rest, version, values, place) do
    with {:ok, values, rest} <- read(layout, rest, version, values, :inner),
         do: read(more, rest, version, values, place)
  end

  defp read([{:list, key, count, layout} | more], rest, version, values, place) do
    case if(is_integer(count) or count == :rest, do: count, else: values[count]) do
      nil ->
        read(more, rest, version, values, place)

      count ->
        with {:ok, list, rest} <- read_list(layout, rest, version, count, []),
             do: read(more, rest, version, Map.put(values, key, list), place)
    end
  end

  defp read([%Field{key: key, type: type} = field | more], rest, version, values, place) do
    if Field.in?(field, version) do
      case take(type, rest) do
        {value, rest} -> read(more, rest, version, Map.put(values, key, value), place)
        :short when rest == "" and place == :outer -> read(more, "", version, values, place)
        :short -> {:error, "it ends inside #{key}"}
      end
    else
      read(more, rest, version, values, place)
    end
  end

  defp read_list(_layout, rest, _version, 0, list), do: {:ok, Enum.reverse(list), rest}
  defp read_list(_layout, "", _version, :rest, list), do: {:ok, Enum.reverse(list), ""}

  defp read_list(layout, rest, version, count, list) do
    case read(layout, rest, version, %{}, :inner) do
      # An entry without fields for this version.
      {:ok, _values, ^rest} -> {:ok, Enum.reverse(list), rest}
      {:ok, values, rest} -> read_list(layout, rest, version, fewer(count), [values | list])
      {:error, _why} = error -> error
    end
  end

  defp fewer(:rest), do: :rest
  defp fewer(count), do: count - 1

  defp take(:u8, <<value, rest::binary>>), do: {value, rest}
  defp take(:i8, <<value::signed, rest::binary>>), do: {value, rest}
  defp take(:u16, <<value::16-little, rest::binary>>), do: {value, rest}
  defp take(:i16, <<value::16-little-signed, rest::binary>>), do: {value, rest}
  defp take(:u32, <<value::32-little, rest::binary>>), do: {value, rest}
  defp take(:i32, <<value::32-little-signed, rest::binary>>), do: {value, rest}
  defp take(:u64, <<value::64-little, rest::binary>>), do: {value, rest}
  defp take(:pstr, <<size, text::binary-size(size), rest::binary>>), do: {text, rest}
  defp take(type, rest) when type in [:strrest, :rest], do: {rest, ""}

  defp take({_kind, size}, rest) do
    case rest do
      <<value::binary-size(^size), rest::binary>> -> {value, rest}
      _short -> :short
    end
  end

  defp take(:zstr, rest) do
    case :binary.split(rest, <<0>>) do
      [text, rest] -> {text, rest}
      [_unended] -> :short
    end
  end

  defp take(_type, _short), do: :short

  @doc """
  The payload of some values. It ends before the first field that is missing, unless a later one is there.

      iex> {:ok, message} = MavCodec.Msp.Messages.fetch(:betaflight, "SET_ARMING_CONFIG")
      iex> MavCodec.Msp.Payload.encode(message.request, %{auto_disarm_delay: 5, unused: 0, small_angle: 180}, {1, 46})
      {:ok, <<5, 0, 180>>}
      iex> MavCodec.Msp.Payload.encode(message.request, %{auto_disarm_delay: 5, small_angle: 180}, {1, 46})
      {:error, "unused is missing"}
      iex> MavCodec.Msp.Payload.encode(message.request, %{auto_disarm_delay: 300}, {1, 46})
      {:error, "auto_disarm_delay must be a u8, and is 300"}
  """
  @spec encode(Field.layout(), values, Message.version() | nil) :: {:ok, binary} | {:error, error}
  def encode(layout, values, version) do
    bytes = write(layout, values, version, %{bytes: "", missing: nil}).bytes
    {:ok, bytes <> Map.get(values, :tail, "")}
  catch
    {:unfit, why} -> {:error, why}
  end

  defp write(layout, values, version, out) do
    counts =
      for {:list, key, count, _inner} <- layout,
          is_atom(count) and count != :rest,
          into: %{},
          do: {count, key}

    Enum.reduce(layout, out, fn
      {:optional, inner}, out ->
        write(inner, values, version, out)

      {:list, key, _count, inner}, out ->
        case values do
          %{^key => list} when is_list(list) -> Enum.reduce(list, out, &write(inner, &1, version, &2))
          _none -> missing(out, key)
        end

      %Field{key: key} = field, out ->
        if Field.in?(field, version), do: put(out, field, value(values, key, counts)), else: out
    end)
  end

  # How many entries a list has is counted, not believed.
  defp value(values, key, counts) do
    case counts do
      %{^key => list} when is_map_key(values, list) -> length(Map.fetch!(values, list))
      _no_count -> Map.get(values, key)
    end
  end

  defp put(out, field, nil), do: missing(out, field.key)

  defp put(out, %{key: key, type: type}, value) do
    case bytes(type, value) do
      "" ->
        out

      _more when out.missing != nil ->
        unfit("#{out.missing} is missing")

      bytes when is_binary(bytes) ->
        %{out | bytes: out.bytes <> bytes}

      :unfit ->
        unfit("#{key} must be #{name(type)}, and is #{inspect(value, limit: 20, printable_limit: 80)}")
    end
  end

  defp missing(%{missing: nil} = out, key), do: %{out | missing: key}
  defp missing(out, _key), do: out

  defp bytes(:u8, value) when value in 0..0xFF, do: <<value>>
  defp bytes(:i8, value) when value in -0x80..0x7F, do: <<value>>
  defp bytes(:u16, value) when value in 0..0xFFFF, do: <<value::16-little>>
  defp bytes(:i16, value) when value in -0x8000..0x7FFF, do: <<value::16-little>>
  defp bytes(:u32, value) when value in 0..0xFFFFFFFF, do: <<value::32-little>>
  defp bytes(:i32, value) when value in -0x80000000..0x7FFFFFFF, do: <<value::32-little>>
  defp bytes(:u64, value) when value in 0..0xFFFFFFFFFFFFFFFF, do: <<value::64-little>>
  defp bytes(:pstr, text) when byte_size(text) < 256, do: <<byte_size(text), text::binary>>
  defp bytes(type, bytes) when type in [:strrest, :rest] and is_binary(bytes), do: bytes
  defp bytes({_kind, size}, bytes) when byte_size(bytes) == size, do: bytes

  defp bytes({:text, size}, text) when byte_size(text) < size,
    do: text <> :binary.copy(<<0>>, size - byte_size(text))

  defp bytes(:zstr, text) when is_binary(text) do
    if :binary.match(text, <<0>>) == :nomatch, do: text <> <<0>>, else: :unfit
  end

  defp bytes(_type, _value), do: :unfit

  defp name({:text, size}), do: "text of at most #{size} bytes"
  defp name({:raw, size}), do: "#{size} bytes"
  defp name(:pstr), do: "text of at most 255 bytes"
  defp name(:zstr), do: "text without NUL"
  defp name(type) when type in [:strrest, :rest], do: "bytes"
  defp name(type) when type in [:i8, :i16, :i32], do: "an #{type}"
  defp name(type), do: "a #{type}"

  @spec unfit(String.t()) :: no_return
  defp unfit(why), do: throw({:unfit, why})
end
