defmodule MavCodec.Conformance.MessagesTest do
  @moduledoc "Every message of every dialect against pymavlink: its tables, and frames that it made."
  use ExUnit.Case, async: true

  alias MavCodec.{Golden, Message}

  setup_all do
    %{messages: Golden.messages()}
  end

  test "F4, F5: id, name, CRC_EXTRA, lengths and targets of every message of every dialect" do
    dialects = Golden.dialects()
    assert length(dialects) == 39

    for {dialect, messages} <- dialects do
      assert dialect.ids() == Enum.map(messages, &hd/1), "the ids of #{inspect(dialect)}"

      for [id, name, crc_extra, min, max, system, component] <- messages do
        targets = if system || component, do: {system, component}
        expected = {id, name, crc_extra, {min, max}, targets}

        assert {dialect.message_id(name), dialect.name(id), dialect.crc_extra(id), dialect.length(id),
                dialect.targets(id)} ==
                 expected,
               "#{name} of #{inspect(dialect)}"

        assert {dialect.module_for(id).id(), dialect.module_for(id).name()} == {id, name}
      end
    end
  end

  test "the merged dialects have all messages of both sources, with the layouts of the first" do
    for {all, first, second} <- [
          {MavCodec.Dialects.All, MavCodec.Dialects.Upstream, MavCodec.Dialects.Ardupilot},
          {MavCodec.Dialects.AllArdupilot, MavCodec.Dialects.Ardupilot, MavCodec.Dialects.Upstream}
        ] do
      assert all.ids() == Enum.uniq(Enum.sort(first.ids() ++ second.ids()))

      for id <- all.ids() do
        source = if first.module_for(id), do: first, else: second

        assert {all.module_for(id), all.length(id), all.crc_extra(id)} ==
                 {source.module_for(id), source.length(id), source.crc_extra(id)}
      end
    end
  end

  test "v2 frames decode to the values they were made of, and these encode to the same payload (F7)",
       context do
    for %{dialect: dialect, id: id} = message <- context.messages, frame <- message.frames do
      payload = Golden.payload(frame.v2)
      assert dialect.decode(id, payload) == {:ok, frame.message}, label(message, frame)
      assert Message.encode_payload(frame.message, 2, dialect) == {:ok, id, dialect.crc_extra(id), payload}
    end
  end

  test "F8: the same payload untruncated, and F9: with surplus bytes", context do
    for %{dialect: dialect, id: id} = message <- context.messages, frame <- message.frames do
      {_min, max} = dialect.length(id)
      payload = Golden.payload(frame.v2)
      full = payload <> <<0::size(max - byte_size(payload))-unit(8)>>
      assert dialect.decode(id, full) == {:ok, frame.message}, label(message, frame)
      assert dialect.decode(id, full <> <<1, 255, 0>>) == {:ok, frame.message}, label(message, frame)
    end
  end

  test "F9: v1 frames have the base fields only", context do
    for %{dialect: dialect, id: id} = message <- context.messages, frame <- message.frames, frame.v1 do
      base = without_extensions(frame.message)
      payload = Golden.payload(frame.v1)

      assert MavCodec.decode(%{version: 1, id: id, payload: payload}, dialect) == {:ok, base},
             label(message, frame)

      assert Message.encode_payload(frame.message, 1, dialect) == {:ok, id, dialect.crc_extra(id), payload}
      # Something behind the base fields of a v1 frame is not an extension.
      surplus = payload <> <<1, 2, 3>>

      assert MavCodec.decode(%{version: 1, id: id, payload: surplus}, dialect) == {:ok, base},
             label(message, frame)
    end
  end

  test "every message has golden frames, ids below 256 in both versions", context do
    names = MapSet.new(context.messages, & &1.name)

    for {_dialect, messages} <- Golden.dialects(), [_id, name | _] <- messages, do: assert(name in names)

    for message <- context.messages do
      assert length(message.frames) >= 6
      assert Enum.all?(message.frames, &(is_binary(&1.v1) == message.id < 256))
    end
  end

  defp without_extensions(%module{} = message) do
    for %{extension: true, key: key} <- module.fields(), reduce: message do
      message -> Map.replace!(message, key, Map.fetch!(struct(module), key))
    end
  end

  defp label(message, frame), do: "#{message.name} (#{inspect(message.dialect)}), #{frame.kind}"
end
