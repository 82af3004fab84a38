defmodule MavCodec.Signing.RedactTest do
  use ExUnit.Case, async: true

  alias MavCodec.{Frame, SecretSamples}
  alias MavCodec.Signing.Redact
  alias MavCodec.Dialects.All
  alias MavCodec.Messages, as: M

  @secret SecretSamples.secret()

  defp frame(message) do
    frame =
      message |> MavCodec.encode(system: 42, component: 1) |> IO.iodata_to_binary() |> Frame.from_bytes(nil)

    %{frame | crc_extra: All.crc_extra(frame.id)}
  end

  test "a frame without its secrets has the rest of its fields, whichever message it is" do
    for %module{} = message <- SecretSamples.all() do
      frame = frame(message)
      assert Redact.secret?(frame)
      assert :binary.match(frame.bytes, @secret) != :nomatch
      redacted = Redact.frame(frame)
      assert :binary.match(redacted.bytes, @secret) == :nomatch, module.name()
      assert {:ok, read} = MavCodec.decode(redacted)
      assert Map.drop(read, SecretSamples.fields(module)) == Map.drop(message, SecretSamples.fields(module))
    end
  end

  test "surplus bytes, a secret that is cut off, and a message that is not in the dialect keep nothing" do
    for message <- SecretSamples.all(),
        {_id, _name, spans, _kept?} = List.keyfind(Redact.table(), message.__struct__.id(), 0) do
      %{id: id, payload: payload} = frame(message)
      cut = Enum.max(Enum.map(spans, &elem(&1, 0))) + 4
      whole = payload <> <<0::size(240 - byte_size(payload))-unit(8)>> <> @secret

      for payload <- [whole, binary_part(whole, 0, cut)] do
        odd = id |> MavCodec.Frame.Raw.frame(payload, 0, system: 42, truncate: false) |> Frame.from_bytes(nil)
        assert :binary.match(Redact.frame(odd).payload, binary_part(@secret, 0, 4)) == :nomatch
      end
    end
  end

  test "what is not secret stays: other parameters, an address without a login, other messages" do
    for message <- [
          %M.ParamExtSet{param_id: "CAM_EXPOSURE", param_value: "7"},
          %M.VideoStreamInformation{uri: "rtsp://cam/1"},
          %M.ParamSet{param_id: "RTL_ALT", param_value: 15.0}
        ] do
      frame = frame(message)
      assert {Redact.secret?(frame), Redact.kept?(frame), Redact.frame(frame)} == {false, false, frame}
    end
  end

  test "the list is that of the definitions: ids, names, places, and every field whose name says that it is secret" do
    for module <- SecretSamples.modules() do
      {_id, _crc_extra, _shortest, layout} = All.encoder(module)
      {base, extensions} = module.__wire__(layout)

      {places, _length} =
        Enum.map_reduce(base ++ extensions, 0, fn {name, type, length}, at ->
          bytes = bytes(type) * (length || 1)
          {{name, {at, bytes}}, at + bytes}
        end)

      {_id, name, spans, _kept?} = List.keyfind(Redact.table(), module.id(), 0)
      assert name == module.name()

      assert Enum.map(spans, fn {at, bytes, _kind} -> {at, bytes} end) ==
               Enum.map(SecretSamples.fields(module), &Keyword.fetch!(places, &1))
    end

    assert length(SecretSamples.modules()) == length(Redact.table())
    listed = for module <- SecretSamples.modules(), field <- SecretSamples.fields(module), do: {module, field}

    found =
      for module <- Application.spec(:mav_codec, :modules),
          match?(["MavCodec", "Messages", _name], Module.split(module)),
          %{key: key, length: length} when length != nil <- module.fields(),
          name = Atom.to_string(key),
          String.contains?(name, ~w(password passkey secret passphrase)) or
            name in ~w(key pin new_pin puk psk),
          do: {module, key}

    assert length(found) >= 8
    assert found -- listed == []
  end

  defp bytes(type) do
    case Regex.run(~r/\d+/, Atom.to_string(type)) do
      [bits] -> div(String.to_integer(bits), 8)
      nil -> %{char: 1, float: 4, double: 8}[type]
    end
  end
end
