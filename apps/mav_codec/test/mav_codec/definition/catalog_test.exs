defmodule MavCodec.Definition.CatalogTest do
  @moduledoc "Sources put together: what two definitions of one message or one name become."
  use ExUnit.Case, async: true

  alias MavCodec.Definition.{Catalog, Error, Naming}
  alias MavCodec.Definition.Importer.Parser

  defp document(file, body) do
    {:ok, document} = Parser.parse("<mavlink>#{body}</mavlink>", file)
    document
  end

  defp message(id, name, fields \\ "<field type='uint8_t' name='a'/>"),
    do: "<messages><message id='#{id}' name='#{name}'>#{fields}</message></messages>"

  # Sources of one file each, all.xml.
  defp build(sources) do
    Catalog.build!(for {name, body} <- sources, do: {name, %{"all.xml" => document("all.xml", body)}})
  end

  defp entries(catalog, module) do
    dialect = Enum.find(catalog.dialects, &(&1.module == module))
    for {type, layout} <- dialect.entries, do: {type.id, type.module, layout}
  end

  test "the same message in two sources is one module with one layout" do
    catalog = build([{"upstream", message(1, "A")}, {"ardupilot", message(1, "A")}])
    assert [%{module: MavCodec.Messages.A, layouts: [_one]}] = catalog.types
  end

  test "extensions that differ: one module with all fields, a layout for each source" do
    extension = &"<field type='uint8_t' name='a'/><extensions/><field type='uint16_t' name='#{&1}'/>"

    catalog =
      build([{"upstream", message(1, "A", extension.("b"))}, {"ardupilot", message(1, "A", extension.("c"))}])

    assert [%{module: MavCodec.Messages.A, fields: fields, layouts: [_, _]}] = catalog.types
    assert Enum.map(fields, & &1.name) == ["a", "b", "c"]
    assert entries(catalog, MavCodec.Dialects.Upstream) == [{1, MavCodec.Messages.A, 0}]
    assert entries(catalog, MavCodec.Dialects.Ardupilot) == [{1, MavCodec.Messages.A, 1}]
    assert entries(catalog, MavCodec.Dialects.All) == [{1, MavCodec.Messages.A, 0}]
    assert entries(catalog, MavCodec.Dialects.AllArdupilot) == [{1, MavCodec.Messages.A, 1}]
  end

  test "one name with two base layouts, two ids, or an extension of two types is two modules" do
    for other <- [
          message(1, "A", "<field type='uint16_t' name='a'/>"),
          message(2, "A"),
          message(1, "A", "<field type='uint8_t' name='a'/><extensions/><field type='float' name='b'/>")
        ] do
      first =
        message(1, "A", "<field type='uint8_t' name='a'/><extensions/><field type='uint16_t' name='b'/>")

      catalog = build([{"upstream", first}, {"mine", other}])
      assert [_, _] = catalog.types
      assert [{_, one, 0}] = entries(catalog, MavCodec.Dialects.Upstream)
      assert [{id, two, 0}] = entries(catalog, MavCodec.Dialects.Mine)

      assert Enum.sort([one, two]) ==
               Enum.sort([MavCodec.Messages.A, Module.concat(MavCodec.Messages, "A#{id}")])
    end
  end

  test "names that differ only in case or underscores: the lower id keeps the name, whatever the order" do
    a = "<message id='9' name='SIMSTATE'><field type='char' name='a'/></message>"
    b = "<message id='5' name='SIM_STATE'><field type='char' name='a'/></message>"

    for messages <- [a <> b, b <> a] do
      catalog = build([{"upstream", "<messages>#{messages}</messages>"}])

      assert entries(catalog, MavCodec.Dialects.Upstream) == [
               {5, MavCodec.Messages.SimState, 0},
               {9, MavCodec.Messages.Simstate9, 0}
             ]
    end
  end

  test "enums are merged over sources; one name with two values is an error" do
    enum = fn entries -> "<enums><enum name='E'>#{entries}</enum></enums>" end

    catalog =
      build([
        {"upstream", enum.("<entry name='E_A' value='1'/><entry name='E_B' value='2'/>")},
        {"ardupilot", enum.("<entry name='E_ALIAS' value='2'/><entry name='E_C' value='0'/>")}
      ])

    assert [{MavCodec.Enums.E, %{entries: entries}}] = catalog.enums
    assert Enum.map(entries, &{&1.name, &1.value}) == [{"E_C", 0}, {"E_A", 1}, {"E_B", 2}, {"E_ALIAS", 2}]

    assert_raise Error, ~r/E_A of enum E is 7, but 1 in all.xml of another source/, fn ->
      build([
        {"upstream", enum.("<entry name='E_A' value='1'/>")},
        {"mine", enum.("<entry name='E_A' value='7'/>")}
      ])
    end
  end

  test "one id that the two official sources use differently is an error" do
    assert_raise Error, ~r/message id 1 is A in one source and B in another/, fn ->
      build([{"upstream", message(1, "A")}, {"ardupilot", message(1, "B")}])
    end
  end

  test "facts of any folder of sources are loaded again only when they change" do
    folder = MavCodec.Definition.Shard.definitions()
    # What the first load returns is its own term, not yet the one that is kept.
    Catalog.load!(folder)
    assert :erts_debug.same(Catalog.load!(folder), Catalog.load!(folder))
  end

  test "labels lose what all names have in front, but never all of a name" do
    assert Naming.labels("MAV_STATE", ["MAV_STATE_A", "MAV_STATE_B"]) == ["A", "B"]
    assert Naming.labels("COPTER_MODES", ["COPTER_MODE_X", "COPTER_MODE_XY"]) == ["X", "XY"]
    assert Naming.labels("E", ["ONE", "TWO"]) == ["ONE", "TWO"]
    assert Naming.labels("X", ["A_B", "A_B_C"]) == ["B", "B_C"]
    assert Naming.labels("X", ["A_", "A_B"]) == ["A_", "A_B"]
  end
end
