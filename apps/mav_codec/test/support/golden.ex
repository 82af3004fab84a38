defmodule MavCodec.Golden do
  @moduledoc """
  The fixtures that pymavlink made (`test/fixtures/golden`), read for the conformance tests.
  """

  alias MavCodec.Definition.Naming

  @folder Path.expand("../fixtures/golden", __DIR__)

  @doc "The secret key of the signed frames."
  def key, do: :binary.list_to_bin(Enum.to_list(0..31))

  @doc "What pymavlink says of each dialect: `{module, [[id, name, crc, min, max, target system, target component]]}`."
  def dialects do
    for %{"source" => source, "file" => file, "messages" => messages} <- read("dialects.jsonl.gz"),
        do: {Naming.dialect(source, file), messages}
  end

  @doc """
  All messages with their frames: `%{id, name, dialect, module, frames: [%{kind, v1, v2, signed, message}]}`, where
  `message` is the struct that the frames hold, and `v1` and `signed` may be `nil`.
  """
  def messages do
    for %{"source" => where, "id" => id, "name" => name, "fields" => names, "frames" => frames} <-
          read("frames.jsonl.gz") do
      [source, file] = String.split(where, "/")
      dialect = Naming.dialect(source, file)
      module = dialect.module_for(id)
      fields = Map.new(module.fields(), &{&1.name, &1})
      fields = Enum.map(names, &Map.fetch!(fields, &1))
      frames = Enum.map(frames, &frame(&1, module, fields))
      %{id: id, name: name, dialect: dialect, module: module, frames: frames}
    end
  end

  @doc "The payload of a frame, without a parser: a fixture's frames are whole."
  def payload(<<0xFE, length, _::32, payload::binary-size(length), _crc::16>>), do: payload
  def payload(<<0xFD, length, _::64, payload::binary-size(length), _crc_and_signature::binary>>), do: payload

  defp frame(frame, module, fields) do
    message =
      fields
      |> Enum.zip_with(frame["values"], &{&1.key, value(&1, &2)})
      |> then(&struct!(module, &1))

    %{
      kind: frame["kind"],
      v1: bytes(frame["v1"]),
      v2: bytes(frame["v2"]),
      signed: bytes(frame["signed"]),
      message: message
    }
  end

  defp bytes(nil), do: nil
  defp bytes(hex), do: Base.decode16!(hex, case: :lower)

  # pymavlink has single characters as numbers.
  defp value(%{type: :char, length: nil}, number) when is_integer(number),
    do: MavCodec.Message.Value.text(<<number>>)

  defp value(_field, %{"hex" => hex}), do: bytes(hex)
  defp value(field, list) when is_list(list), do: Enum.map(list, &value(field, &1))
  defp value(_field, "nan"), do: :nan
  defp value(%{type: type}, "infinity") when type in [:float, :double], do: :infinity
  defp value(%{type: type}, "neg_infinity") when type in [:float, :double], do: :neg_infinity
  defp value(%{type: :float}, 1.0e-45), do: 2.0 ** -149
  defp value(%{type: type}, value) when type in [:float, :double], do: value * 1.0
  # pymavlink has every char[] as text.
  defp value(%{type: :uint8, length: length}, text) when is_binary(text),
    do: text <> <<0::size(length - byte_size(text))-unit(8)>>

  defp value(_field, value), do: value

  defp read(file) do
    @folder
    |> Path.join(file)
    |> File.read!()
    |> :zlib.gunzip()
    |> String.split("\n", trim: true)
    |> Enum.map(&JSON.decode!/1)
  end
end
