defmodule MavCodec.Message.PropertiesTest do
  @moduledoc "What holds for every message of every dialect, whatever its values and whatever the bytes."
  use ExUnit.Case, async: true

  import Bitwise

  alias MavCodec.Message
  alias MavCodec.Message.{Field, Value}

  # Every dialect that has a message which no other has, so that all layouts are covered.
  @dialects [
    MavCodec.Dialects.All,
    MavCodec.Dialects.AllArdupilot,
    MavCodec.Dialects.Paparazzi,
    MavCodec.Dialects.Ardupilot.Matrixpilot
  ]

  for dialect <- @dialects do
    test "#{inspect(dialect)}: what is encoded decodes to itself, in version 2 and, without extensions, in version 1" do
      each_message(unquote(dialect), 12, fn module, id ->
        :proper.forall(message(module, unquote(dialect)), fn message ->
          {:ok, ^id, crc_extra, payload} = Message.encode_payload(message, 2, unquote(dialect))

          crc_extra == unquote(dialect).crc_extra(id) and byte_size(payload) >= 1 and
            unquote(dialect).decode(id, payload) == {:ok, message} and
            Message.unsayable(message, 2) == nil and
            if(id > 255,
              do: Message.unsayable(message, 1) == :id,
              else: version_1?(message, unquote(dialect), id)
            )
        end)
      end)
    end

    test "#{inspect(dialect)}: any payload is a message (F7, F8, F9), and encodes again" do
      each_message(unquote(dialect), 8, fn module, id ->
        :proper.forall(:proper_types.binary(), fn bytes ->
          {:ok, %{__struct__: ^module} = message} = unquote(dialect).decode(id, bytes)
          {_min, max} = unquote(dialect).length(id)
          filled = binary_part(bytes <> <<0::size(max)-unit(8)>>, 0, max)
          {:ok, ^id, _crc_extra, payload} = Message.encode_payload(message, 2, unquote(dialect))

          unquote(dialect).decode(id, filled) == {:ok, message} and
            unquote(dialect).decode(id, payload) == {:ok, message}
        end)
      end)
    end
  end

  test "F7: a payload cut anywhere reads as if zeros had been cut, for every length" do
    for id <- MavCodec.Dialects.All.ids() do
      {_min, max} = MavCodec.Dialects.All.length(id)
      full = :binary.copy(<<0xA5>>, max)

      for size <- 0..max do
        cut = binary_part(full, 0, size)
        zeros = <<cut::binary, 0::size(max - size)-unit(8)>>
        assert MavCodec.Dialects.All.decode(id, cut) == MavCodec.Dialects.All.decode(id, zeros)
      end
    end
  end

  test "any term in any field is encoded or refused with the field's name, never wrapped and never an exception" do
    terms = [
      -1,
      1 <<< 64,
      1.5,
      -1.0e300,
      1 <<< 2000,
      :nan,
      {:nan, 0},
      "text",
      <<0>>,
      <<1::1>>,
      nil,
      [],
      [1],
      [1 | 2],
      %{},
      self()
    ]

    for {id, module} <- messages(MavCodec.Dialects.All), %Field{key: key} <- module.fields() do
      for term <- terms do
        message = Map.replace!(struct(module), key, term)

        case Message.encode_payload(message, 2, MavCodec.Dialects.All) do
          {:ok, ^id, _crc_extra, payload} ->
            {:ok, decoded} = MavCodec.Dialects.All.decode(id, payload)
            assert same?(Map.fetch!(decoded, key), term), "#{inspect(module)} #{key}: #{inspect(term)}"

          {:error, error} ->
            assert %MavCodec.Message.EncodeError{
                     message: ^module,
                     field: ^key,
                     got: ^term,
                     expected: expected
                   } =
                     error

            assert is_binary(expected) and is_binary(Exception.message(error))
        end
      end
    end
  end

  # What may become of a value that was accepted: an integer a float, a short binary one that is filled up.
  defp same?(decoded, term) when is_number(decoded) and is_number(term), do: decoded == term

  defp same?(decoded, term) when is_binary(decoded) and is_binary(term),
    do: String.starts_with?(decoded, term)

  defp same?(decoded, term), do: decoded == term

  defp each_message(dialect, runs, property) do
    for {id, module} <- messages(dialect) do
      assert :proper.quickcheck(property.(module, id), [:quiet, numtests: runs]) == true, inspect(module)
    end
  end

  defp messages(dialect), do: Enum.map(dialect.ids(), &{&1, dialect.module_for(&1)})

  defp version_1?(message, dialect, id) do
    {:ok, ^id, _crc_extra, payload} = Message.encode_payload(message, 1, dialect)
    {min, _max} = dialect.length(id)
    whole? = Message.unsayable(message, 1) == nil

    byte_size(payload) == min and whole? == (base(message) == message) and
      MavCodec.decode(%{version: 1, id: id, payload: payload}, dialect) == {:ok, base(message)}
  end

  defp base(%module{} = message) do
    for %Field{extension: true, key: key} <- module.fields(), reduce: message do
      message -> Map.replace!(message, key, Map.fetch!(struct(module), key))
    end
  end

  # A message with any values in the fields that the dialect lays out: the values are drawn as bits, so that every
  # float is among them, and turned into what the struct holds.
  defp message(module, dialect) do
    {_id, _crc_extra, base, extensions} = dialect.layout(module)
    fields = base ++ extensions

    :proper_types.fixed_list(Enum.map(fields, fn {_key, type, length} -> bits(type, length) end))
    |> mapped(fn drawn ->
      fields
      |> Enum.zip_with(drawn, fn {key, type, length}, bits -> {key, value(bits, type, length)} end)
      |> then(&struct!(module, &1))
    end)
  end

  defp mapped(type, fun), do: :proper_types.bind(type, fun, false)

  defp bits(type, length) when length != nil and type in [:char, :uint8],
    do: :proper_types.vector(length, :proper_types.integer(0, 255))

  defp bits(type, nil), do: :proper_types.integer(0, (1 <<< (8 * size(type))) - 1)
  defp bits(type, length), do: :proper_types.vector(length, bits(type, nil))

  defp value(byte, :char, nil), do: value([byte], :char, 1)

  defp value(bytes, :char, _length),
    do: bytes |> Enum.take_while(&(&1 != 0)) |> :binary.list_to_bin()

  defp value(bytes, :uint8, length) when length != nil, do: :binary.list_to_bin(bytes)
  defp value(bits, type, nil), do: scalar(bits, type)
  defp value(list, type, _length), do: Enum.map(list, &scalar(&1, type))

  defp scalar(bits, :float), do: Value.float32(bits)
  defp scalar(bits, :double), do: Value.float64(bits)

  defp scalar(bits, type) when type in [:int8, :int16, :int32, :int64] do
    size = 8 * size(type)
    <<signed::signed-size(^size)>> = <<bits::size(size)>>
    signed
  end

  defp scalar(bits, _unsigned), do: bits

  defp size(type), do: MavCodec.Definition.Layout.size(type)
end
