defmodule MavCodec.Definition.CustomTest do
  use ExUnit.Case, async: true

  alias MavCodec.Definition.{Catalog, Custom, Error, Facts, Generator, Shard}
  alias MavCodec.Definition.Importer.Parser
  alias MavCodec.Messages.Heartbeat
  alias MavCodec.Test.Tiny
  alias MavCodec.Test.Tiny.Messages.TinyStatus

  test "a dialect of one's own has its messages and those it includes" do
    assert Tiny.ids() == [0, 50_001, 50_002]
    assert Tiny.module_for(50_001) == TinyStatus
    assert Tiny.length(50_001) == {8, 20}
    assert Tiny.targets(50_001) == {7, nil}
    assert Tiny.message_id("TINY_STATUS") == 50_001
    assert Tiny.crc_extra(0) == MavCodec.Dialects.All.crc_extra(0)
  end

  test "a message that is an official one is that one" do
    assert Tiny.module_for(0) == Heartbeat
    assert {:ok, %Heartbeat{type: 2}} = Tiny.decode(0, <<0, 0, 0, 0, 2>>)
  end

  test "its own messages encode and decode" do
    message = %TinyStatus{state: 200, voltage: :nan, flags: 5, target_system: 1, text: "ab", pair: [-1, 2]}
    assert {:ok, 50_001, crc_extra, payload} = MavCodec.Message.encode_payload(message, 2, Tiny)
    assert crc_extra == Tiny.crc_extra(50_001)
    assert payload == <<0x7FC00000::little-32, 5::little-16, 200, 1, "ab", 0, 0, -1::32, 2>>
    assert Tiny.decode(50_001, payload) == {:ok, message}

    assert {:error, %{expected: "a message of MavCodec.Dialects.All"}} =
             MavCodec.Message.encode_payload(message, 2, MavCodec.Dialects.All)

    assert MavCodec.encode(message, system: 1, dialect: Tiny) |> byte_size() == 12 + 17
  end

  test "enums that it adds or adds to are its own, with all their entries" do
    fields = Map.new(TinyStatus.fields(), &{&1.key, &1})
    assert fields.state.enum == Tiny.Enums.MavState
    assert Tiny.Enums.MavState.name(200) == :MAV_STATE_TINY
    assert Tiny.Enums.MavState.name(4) == :MAV_STATE_ACTIVE
    assert MavCodec.Enums.MavState.name(200) == nil
    assert Tiny.Enums.TinyFlags.flags(7) == {[:TINY_FLAGS_A, :TINY_FLAGS_C], 2}

    assert fields.voltage == %MavCodec.Message.Field{
             key: :voltage,
             name: "Voltage",
             type: :float,
             units: "V",
             invalid: "NaN"
           }
  end

  test "several dialects at once read one stream" do
    bytes =
      MavCodec.encode(%TinyStatus{state: 1}, system: 1, dialect: Tiny) <>
        MavCodec.encode(%MavCodec.Messages.Attitude{roll: 1.0}, system: 1)

    parser = MavCodec.Parser.new(dialects: [Tiny, MavCodec.Dialects.All])

    assert {[%{id: 50_001, crc_extra: extra}, %{id: 30, crc_extra: 39}], _parser} =
             MavCodec.Parser.push(parser, bytes)

    assert extra == Tiny.crc_extra(50_001)
  end

  test "a wrong definition fails the compilation with file, line and reason" do
    code = """
    defmodule MavCodec.Test.Wrong do
      use MavCodec.Dialect, definitions: "wrong.xml"
    end
    """

    assert_raise Error, "wrong.xml: cannot be read: no such file or directory", fn ->
      Code.compile_string(code)
    end
  end

  test "an official message with another extension gets a module of its own" do
    xml = """
    <mavlink><messages><message id="0" name="HEARTBEAT">
      <field type="uint8_t" name="type"/><field type="uint8_t" name="autopilot"/><field type="uint8_t" name="base_mode"/>
      <field type="uint32_t" name="custom_mode"/><field type="uint8_t" name="system_status"/>
      <field type="uint8_t_mavlink_version" name="mavlink_version"/><extensions/><field type="uint16_t" name="more"/>
    </message></messages></mavlink>
    """

    {:ok, document} = Parser.parse(xml, "more.xml")

    {dialect, types, []} =
      Custom.build!(%{"more.xml" => document}, "more.xml", Some.Dialect, Catalog.load!(Shard.definitions()))

    assert [%{module: Some.Dialect.Messages.Heartbeat, layouts: [%{min: 9, max: 11, crc_extra: 50}]} = type] =
             types

    assert [{^type, 0}] = dialect.entries
  end

  describe "the generated code" do
    @snapshots Path.expand("../../fixtures/definition", __DIR__)

    test "facts of the tiny dialect" do
      {:ok, facts} = @snapshots |> Path.join("tiny.xml") |> File.read!() |> Parser.facts("tiny.xml")
      assert_snapshot("tiny.facts", facts |> Facts.text() |> IO.iodata_to_binary())
    end

    test "message, enum and dialect modules of the tiny dialect" do
      {:ok, document} = @snapshots |> Path.join("tiny.xml") |> File.read!() |> Parser.parse("tiny.xml")

      document = %{
        document
        | includes: [],
          enums: [List.last(document.enums)],
          messages: Enum.map(document.messages, &without_enum/1)
      }

      {dialect, types, [{_, enum}]} =
        Custom.build!(%{"tiny.xml" => document}, "tiny.xml", Tiny, %Catalog{
          types: [],
          enums: [],
          dialects: []
        })

      assert_snapshot("tiny_messages.txt", Enum.map_join(types, "\n", &code(Generator.Messages.body(&1))))
      assert_snapshot("tiny_enum.txt", code(Generator.Enums.body(enum)))
      assert_snapshot("tiny_dialect.txt", code(Generator.Dialects.body(dialect)))
    end

    defp without_enum(message),
      do: %{
        message
        | fields: Enum.map(message.fields, &if(&1.enum == "MAV_STATE", do: %{&1 | enum: nil}, else: &1))
      }

    defp code(quoted), do: Macro.to_string(quoted) <> "\n"

    # SNAPSHOTS=write rewrites them; then look at the difference.
    defp assert_snapshot(name, text) do
      path = Path.join(@snapshots, name)
      if System.get_env("SNAPSHOTS") == "write", do: File.write!(path, text)
      assert File.read!(path) == text
    end
  end
end
