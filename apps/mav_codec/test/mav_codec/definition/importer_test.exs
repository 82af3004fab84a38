defmodule MavCodec.Definition.ImporterTest do
  @moduledoc "Several files: includes, what they merge, where they clash; and `mix mav.import`, which writes the result."
  use ExUnit.Case, async: true

  alias MavCodec.Definition.{Error, Facts, Importer, Shard}

  @moduletag :tmp_dir

  defp xml(body), do: "<mavlink>\n#{body}\n</mavlink>"

  defp message(id, name),
    do: "<messages><message id='#{id}' name='#{name}'><field type='char' name='a'/></message></messages>"

  defp enum(name, entries),
    do:
      "<enums><enum name='#{name}'>#{for {n, v} <- entries, do: "<entry name='#{n}' value='#{v}'/>"}</enum></enums>"

  defp write(%{tmp_dir: dir}, files) do
    for {name, body} <- files do
      path = Path.join(dir, name)
      File.mkdir_p!(Path.dirname(path))
      File.write!(path, xml(body))
    end
  end

  defp import_file(%{tmp_dir: dir}, file, base \\ nil), do: Importer.import([Path.join(dir, file)], base)

  test "F11: includes are followed recursively, each file once", context do
    write(context, [
      {"a.xml", "<include>b.xml</include><include>c.xml</include>" <> message(1, "A")},
      {"b.xml", "<include>c.xml</include>" <> message(2, "B")},
      {"c.xml", message(3, "C")}
    ])

    assert {:ok, files} = import_file(context, "a.xml")
    assert Enum.map(files, &elem(&1, 0)) == ["a.facts", "b.facts", "c.facts"]
    assert {:ok, ^files} = import_file(context, "a.xml")
  end

  test "F11: a cycle of includes is not an error", context do
    write(context, [
      {"a.xml", "<include>b.xml</include>" <> message(1, "A")},
      {"b.xml", "<include>a.xml</include><include>b.xml</include>" <> message(2, "B")}
    ])

    assert {:ok, [{"a.facts", _}, {"b.facts", _}]} = import_file(context, "a.xml")
  end

  test "an include may be in another folder, but two files of one name cannot be told apart", context do
    write(context, [
      {"a.xml", "<include>sub/b.xml</include>"},
      {"sub/b.xml", "<include>../c.xml</include>" <> message(1, "B")},
      {"c.xml", message(2, "C")}
    ])

    assert {:ok, [_, _, _]} = import_file(context, "a.xml")

    write(context, [
      {"sub/b.xml", "<include>c.xml</include>"},
      {"sub/c.xml", ""},
      {"a.xml", "<include>c.xml</include><include>sub/b.xml</include>"}
    ])

    assert {:error, %Error{file: "c.xml", reason: "another file of this name is needed too" <> _}} =
             import_file(context, "a.xml")
  end

  test "a missing include names the file and the line that ask for it", context do
    write(context, [{"a.xml", "<include>b.xml</include>"}, {"b.xml", "\n<include>gone.xml</include>"}])

    assert import_file(context, "a.xml") ==
             {:error, %Error{file: "b.xml", line: 3, reason: "included file gone.xml is missing"}}
  end

  test "an include that is nowhere beside comes from the base, an imported source", context do
    write(context, [{"mine.xml", "<include>standard.xml</include>" <> message(50_000, "MINE")}])

    assert {:error, %Error{reason: "included file standard.xml is missing"}} =
             import_file(context, "mine.xml")

    assert {:ok, files} = import_file(context, "mine.xml", Path.join(Shard.definitions(), "upstream"))
    assert Enum.map(files, &elem(&1, 0)) == ["mine.facts", "minimal.facts", "standard.facts"]
    # What comes from the base is copied as it is.
    for {name, facts} <- files, name != "mine.facts" do
      assert IO.iodata_to_binary(facts) == File.read!(Path.join([Shard.definitions(), "upstream", name]))
    end
  end

  test "enums of one name are merged over files; the same entry in both is one", context do
    write(context, [
      {"a.xml", "<include>b.xml</include>" <> enum("E", E_A: 1, E_B: 2)},
      {"b.xml", enum("E", E_A: 1, E_C: 3)}
    ])

    assert {:ok, _files} = import_file(context, "a.xml")
  end

  for {what, a, b, line, reason} <- [
        {"an enum entry with two values",
         "<enums><enum name='E'><entry name='E_A' value='1'/></enum></enums>",
         "<enums><enum name='E'><entry name='E_A' value='2'/></enum></enums>", 3,
         "E_A of enum E is 1, but 2 in b.xml:2"},
        {"an enum value with two names", "<enums><enum name='E'><entry name='E_A' value='1'/></enum></enums>",
         "<enums><enum name='E'><entry name='E_B' value='1'/></enum></enums>", 3,
         "E_A of enum E has the value 1 of E_B in b.xml:2"},
        {"a message id for two messages",
         "<messages><message id='1' name='A'><field type='char' name='a'/></message></messages>",
         "<messages><message id='1' name='B'><field type='char' name='a'/></message></messages>", 3,
         "message id 1 (A) is already used by B in b.xml:2"},
        {"a message name for two ids",
         "<messages><message id='1' name='A'><field type='char' name='a'/></message></messages>",
         "<messages><message id='2' name='A'><field type='char' name='a'/></message></messages>", 3,
         "message name A is already used by A in b.xml:2"},
        {"an enum that does not exist",
         "<messages><message id='1' name='A'><field type='uint8_t' name='a' enum='NONE'/></message></messages>",
         "", 3, "field a of A has the unknown enum NONE"}
      ] do
    test "refuses #{what}", context do
      write(context, [{"a.xml", "<include>b.xml</include>\n" <> unquote(a)}, {"b.xml", unquote(b)}])

      assert import_file(context, "a.xml") ==
               {:error, %Error{file: "a.xml", line: unquote(line), reason: unquote(reason)}}
    end
  end

  describe "mix mav.import" do
    setup do
      Mix.shell(Mix.Shell.Process)
      on_exit(fn -> Mix.shell(Mix.Shell.IO) end)
    end

    test "writes one facts file for each definition file, the same bytes each time",
         %{tmp_dir: dir} = context do
      write(context, [{"a.xml", "<include>b.xml</include>" <> message(1, "A")}, {"b.xml", message(2, "B")}])
      out = Path.join(dir, "out")
      run = fn -> Mix.Task.rerun("mav.import", [Path.join(dir, "a.xml"), "--out", out]) end

      run.()
      assert_received {:mix_shell, :info, ["2 definition files in " <> _]}
      first = for file <- File.ls!(out), do: {file, File.read!(Path.join(out, file))}
      assert first |> Enum.map(&elem(&1, 0)) |> Enum.sort() == ["a.facts", "b.facts"]
      run.()
      assert first == for(file <- File.ls!(out), do: {file, File.read!(Path.join(out, file))})
    end

    test "says file, line and reason, and writes nothing, when one file is bad", %{tmp_dir: dir} = context do
      write(context, [{"a.xml", "<include>b.xml</include>"}, {"b.xml", "\n\n<oops/>"}])
      out = Path.join(dir, "out")

      assert_raise Mix.Error,
                   "b.xml:4: <oops> inside of mavlink, expected one of include, version, dialect, enums, messages",
                   fn ->
                     Mix.Task.rerun("mav.import", [Path.join(dir, "a.xml"), "--out", out])
                   end

      refute File.exists?(out)
    end

    test "usage errors are one line each", %{tmp_dir: dir} do
      for {args, error} <- [
            {[], "mav.import: no file given (mix help mav.import)"},
            {["--what", "a.xml"], "mav.import: unknown option --what (mix help mav.import)"},
            {["a.xml", "--source", "../x"], ~S(mav.import: --source "../x": expected letters, digits and _)},
            {[Path.join(dir, "none.xml")], "none.xml: cannot be read: no such file or directory"}
          ] do
        assert_raise Mix.Error, error, fn -> Mix.Task.rerun("mav.import", args) end
      end
    end
  end

  test "the definition of docs/guides/dialect.md is imported", %{tmp_dir: dir} do
    [_all, xml] =
      Regex.run(
        ~r/^```xml\n(.*?)^```$/ms,
        File.read!(Path.expand("../../../../../docs/guides/dialect.md", __DIR__))
      )

    path = Path.join(dir, "sprayer.xml")
    File.write!(path, xml)
    assert {:ok, files} = Importer.import([path], Path.expand("../../../priv/definitions/upstream", __DIR__))
    assert {_name, facts} = List.keyfind(files, "sprayer.facts", 0)
    assert IO.iodata_to_binary(facts) =~ "SPRAYER_STATUS"
  end

  test "the facts that are checked in are what facts read and written again give" do
    for file <- Shard.files() do
      text = File.read!(file)
      assert text |> Facts.facts() |> Facts.text() |> IO.iodata_to_binary() == text
    end
  end
end
