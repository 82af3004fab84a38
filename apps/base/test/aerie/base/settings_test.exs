defmodule Aerie.Base.SettingsTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Settings
  alias Aerie.Base.Settings.{Field, Schema, Types}

  defmodule Owner do
    use Aerie.Base.Settings

    section ""
    setting :network, :string, "Its network.", default: "main"
    section "owner", "Who has the pump."
    setting :floor, {:integer, 1, 255}, "Where.", default: 1

    @impl Settings
    def problems(%{owner: %{floor: floor}, network: network}) do
      Settings.Rules.failed([
        {floor == 13, ["owner", "floor"], "another floor than 13", "13"},
        {network == "", ["network"], "a name", "nothing"}
      ])
    end
  end

  defmodule Tank do
    use Aerie.Base.Settings

    section "tank", "A tank."
    setting :max_l, {:integer, 1, 100}, "Size.", key: "size.max_l", default: 10
  end

  defmodule Pump do
    use Aerie.Base.Settings

    part :owner, Owner

    section "pump", "A pump."
    setting :pause_ms, {:number, 0, 10}, "Pause.", key: "pause_s", default: 0.5, times: 1000
    setting :mode, {:enum, [:slow, :fast]}, "Mode.", default: :slow
    setting :clock, :string, "For tests.", internal: true, default: System
    setting :hose, {:section, hose()}, "Its hose."

    section "limits"
    setting :max_pumps, {:integer, 1, 9}, "Pumps.", default: 2

    defp hose,
      do: [
        field(:metres, {:integer, 1, 100}, "Length.", default: 10),
        field(:leaks, :boolean, "", default: true)
      ]

    @impl Settings
    def derive(settings), do: %{settings | mode: if(settings.max_pumps > 5, do: :fast, else: settings.mode)}
  end

  test "what a configuration does not say has its default, in the part's units; other keys do not matter" do
    assert %Pump{pause_ms: 500, mode: :slow, clock: System, max_pumps: 2} = Pump.from(%{http: %{port: 1}})

    assert %Pump{pause_ms: 1500, hose: %{metres: 3, leaks: true}} =
             Pump.from(%{pump: %{pause_s: 1.5, hose: %{metres: 3}}})

    assert %Pump{hose: %{metres: 10, leaks: false}} =
             Pump.from(%{pump: %{hose: %{leaks: false, metres: nil}}})

    assert %Pump{mode: :fast} = Pump.from(%{limits: %{max_pumps: 6}})
    assert %Pump{clock: Fake} = Pump.from(%{pump: %{clock: Fake}})

    assert %Pump{owner: %Owner{network: "south", floor: 1}} = Pump.from(%{network: "south"})
  end

  test "a part's own map is checked: types, ranges, unknown keys, those of its parts too" do
    assert {:ok, pump} = Pump.new(%{pump: %{mode: :fast}, owner: %{"floor" => 7}})
    assert %{mode: :fast, pause_ms: 500, owner: %{floor: 7}} = pump
    assert Pump.new(%{}) == {:ok, Pump.from(%{})}

    assert {:error, [%{path: ["pump", "mod"], hint: "did you mean \"mode\"?"}]} =
             Pump.new(%{pump: %{mod: "fast"}})

    assert {:error, [%{path: ["pump", "clock"]}]} = Pump.new(%{pump: %{clock: "x"}})
    assert {:error, [range]} = Pump.new(%{limits: %{max_pumps: 10}})
    assert %{path: ["limits", "max_pumps"], expected: "an integer from 1 to 9", got: "10"} = range
    assert {:error, [%{expected: "one of slow, fast"}]} = Pump.new(%{pump: %{mode: "stuck"}})
  end

  test "parts make one schema: sections in the order of their first keys, with their meanings" do
    fields = Settings.fields([Pump, Tank], %{"limits" => "Bounds."})

    assert [%Field{key: :pump, doc: "A pump."}, %Field{key: :limits, doc: "Bounds."}, %Field{key: :tank}] =
             fields

    paths = for {path, _field} <- Schema.leaves(fields), do: Enum.join(path, ".")
    assert "pump.hose.metres" in paths and "tank.size.max_l" in paths
    refute "pump.clock" in paths
  end

  test "text is read as its key's type; lists and maps by the reader that came with it" do
    fields = [
      Field.field(:ports, {:list, {:integer, 1, 9}}, "p", default: []),
      Field.field(:m, {:map, :boolean}, "m")
    ]

    json = fn text -> {:ok, JSON.decode!(text)} end

    assert {%{ports: [1, 2]}, []} =
             Schema.validate(fields, %{"ports" => {:text, "1, 2", fn _text -> {:ok, "1, 2"} end}})

    assert {%{ports: [3]}, []} = Schema.validate(fields, %{"ports" => {:text, "[3]", json}})
    assert {%{m: %{"a" => true}}, []} = Schema.validate(fields, %{"m" => {:text, ~s({"a": true}), json}})
    broken = fn _text -> {:error, %{expected: "valid YAML", got: "a tab"}} end

    assert {_, [%{path: ["m"], expected: "valid YAML", got: "a tab"}]} =
             Schema.validate(fields, %{"m" => {:text, "x", broken}})
  end

  test "limits of numbers are part of the type" do
    fields = [Field.field(:n, {:integer, 1, 3}, "n"), Field.field(:x, {:number, 0, 1}, "x")]
    assert {%{n: 3, x: 1.0}, []} = Schema.validate(fields, %{"n" => 3, "x" => 1})
    assert {_, [%{path: ["n"]}, %{path: ["x"]}]} = Schema.validate(fields, %{"n" => 4, "x" => 1.1})
    assert {_, [%{path: ["n"]}, %{path: ["x"]}]} = Schema.validate(fields, %{"n" => 1.5, "x" => "1"})
    assert {_, [_, _]} = Schema.validate(fields, %{"n" => {:text, "1x"}, "x" => {:text, "1e999"}})
    assert {%{n: 2, x: 0.5}, []} = Schema.validate(fields, %{"n" => {:text, "2"}, "x" => {:text, "0.5"}})
  end

  test "rules of several keys give the problems that hold, and names that are taken twice" do
    config = %{network: "main", owner: %{floor: 13}}

    assert [%{path: ["owner", "floor"], expected: "another floor than 13", got: "13", hint: nil}] =
             Owner.problems(config)

    assert Owner.problems(%{config | owner: %{floor: 1}}) == []
    assert Pump.problems(config) == [] and Pump.warnings(config) == []
    assert Settings.Rules.texts([{true, "one"}, {false, "other"}]) == ["one"]
    links = [%{id: "a"}, %{id: "b"}, %{id: "a"}]

    assert [%{path: ["links"], got: "\"a\" more than once"}] =
             Settings.Rules.twice(links, & &1.id, ["links"], "ids that differ")
  end

  test "each mistake is found at once, with its path, what was expected and what to do" do
    fields = [
      Field.field(:name, :string, "n", required: true),
      Field.field(:key, :secret, "k"),
      Field.field(:file, :path, "f"),
      Field.field(:on, :boolean, "o", default: true),
      Field.field(:only, {:list, :string}, "l", filled: true, default: []),
      Field.field(:host, Types.host(), "h"),
      Field.section(:more, "m", [Field.field(:n, {:integer, 1, 2}, "n", default: 1)])
    ]

    problems = fn raw ->
      fields |> Schema.validate(raw) |> elem(1) |> Enum.map(&{Enum.join(&1.path, "."), &1.got, &1.hint})
    end

    assert problems.(%{}) == [{"name", "nothing (it is required)", nil}]
    assert problems.("text") == [{"", "\"text\"", nil}]
    assert problems.(%{"name" => " "}) == [{"name", "\" \"", nil}]
    assert problems.(%{"name" => "x", "file" => ""}) == [{"file", "\"\"", nil}]

    assert problems.(%{"name" => "x", "on" => nil}) == [
             {"on", "nothing", "leave the key out for its default"}
           ]

    assert problems.(%{"name" => "x", "only" => []}) == [
             {"only", "an empty list", "leave the key out for all"}
           ]

    assert problems.(%{"name" => "x", "more" => [1]}) == [{"more", "a list (1 items)", nil}]

    assert problems.(%{"name" => "x", "more" => %{"m" => 1}}) == [
             {"more.m", "an unknown one", "known here: n"}
           ]

    assert problems.(%{"name" => "x", "nmae" => 1}) == [{"nmae", "an unknown one", "did you mean \"name\"?"}]
    # A secret never shows, also not one of the wrong type.
    assert problems.(%{"name" => "x", "key" => 12}) == [{"key", "a number", "write it in quotes"}]
    assert problems.(%{"name" => "x", "key" => ["s3cret"]}) == [{"key", nil, nil}]
    assert problems.(%{"name" => "x", "key" => ""}) == [{"key", "\"\"", nil}]

    assert {%{key: key, name: "7", on: false, more: %{n: 2}}, []} =
             Schema.validate(fields, %{
               "key" => "s3cret",
               "name" => 7,
               "on" => {:text, "off"},
               "more" => %{"n" => 2}
             })

    assert Aerie.Base.Secret.reveal(key) == "s3cret"
    refute inspect(key) =~ "s3cret"
  end

  test "long values are cut, and a long list is refused" do
    assert Schema.show(String.duplicate("x", 100)) == "\"" <> String.duplicate("x", 57) <> "...\""
    assert Schema.show(%{a: 1}) == "a section (1 keys)"
    assert Schema.show({1, 2}) == "something else"
    assert Schema.show(1.5) == "1.5"
    fields = [Field.field(:l, {:list, :boolean}, "l")]
    assert {_, [%{expected: expected}]} = Schema.validate(fields, %{"l" => List.duplicate(true, 10_001)})
    assert expected =~ "at most 10000"
  end

  test "a list may be one item, a map has free names, text has commas" do
    fields = [
      Field.field(:l, {:one_or_list, {:enum, [:a, :b]}}, "l", default: []),
      Field.field(:m, {:map, {:integer, 1, 9}}, "m", default: %{})
    ]

    assert {%{l: [:a], m: %{"x" => 1}}, []} = Schema.validate(fields, %{"l" => "a", "m" => %{"x" => 1}})
    text = {:text, "a, b", fn text -> {:ok, text} end}
    assert {%{l: [:a, :b]}, []} = Schema.validate(fields, %{"l" => text})
    assert {_, [%{path: ["l", 1], expected: "one of a, b"}]} = Schema.validate(fields, %{"l" => ["a", "c"]})
    assert {_, [%{path: ["m", "x"], got: "10"}]} = Schema.validate(fields, %{"m" => %{"x" => 10}})
    assert {_, [%{path: ["m"], expected: "names with values" <> _}]} = Schema.validate(fields, %{"m" => 3})
    assert {%{m: %{}}, []} = Schema.validate(fields, %{"m" => []})
  end

  test "a typed tree is completed with the defaults of its fields, also in lists of sections" do
    item = [Field.field(:id, :string, "i"), Field.field(:n, {:integer, 1, 9}, "n", default: 3)]
    fields = [Field.field(:items, {:list, {:section, item}}, "i", default: []), Field.section(:s, "s", item)]
    assert Schema.complete(fields, %{}) == %{items: [], s: %{id: nil, n: 3}}

    assert Schema.complete(fields, %{items: [%{id: "a"}], s: %{n: 4}}) ==
             %{items: [%{id: "a", n: 3}], s: %{id: nil, n: 4}}
  end

  test "what callers in Elixir write is read as a file's values" do
    assert Schema.plain(%{a: :b, c: nil, d: [true, nil, %{e: 1.5}]}) == %{
             "a" => "b",
             "d" => [true, nil, %{"e" => 1.5}]
           }
  end

  test "names, ids, hosts and origins have a form" do
    parse = fn {:parse, fun, _words}, text -> fun.(text) end
    assert parse.(Types.token(), "VID-001") == {:ok, "VID-001"}
    for bad <- ["", "a.b", "a b", String.duplicate("a", 65)], do: assert(parse.(Types.token(), bad) == :error)
    assert parse.(Types.system_id(), "auto") == {:ok, :auto}
    assert parse.(Types.system_id(), "4294967295") == {:ok, 4_294_967_295}
    for bad <- ["0", "4294967296", "1x", ""], do: assert(parse.(Types.system_id(), bad) == :error)
    assert parse.(Types.listen_address(), "off") == {:ok, :off}
    assert parse.(Types.listen_address(), "false") == {:ok, :off}
    assert parse.(Types.ip(), "::1") == {:ok, "::1"}
    for bad <- ["localhost", "1.2.3", ""], do: assert(parse.(Types.ip(), bad) == :error)
    assert parse.(Types.host(), "GCS.Example.org") == {:ok, "gcs.example.org"}
    for bad <- ["", "a..b", "a:80", "a/b"], do: assert(parse.(Types.host(), bad) == :error)
    assert parse.(Types.origin(), "HTTPS://gcs.example.org:8443") == {:ok, "https://gcs.example.org:8443"}

    for bad <- ["gcs.example.org", "ftp://a", "http://a/b", "http://u@a", "http://"],
        do: assert(parse.(Types.origin(), bad) == :error)
  end

  test "addresses" do
    assert Types.parse_listen(":14550") == {:ok, {"0.0.0.0", 14_550}}
    assert Types.parse_listen("127.0.0.1:0") == {:ok, {"127.0.0.1", 0}}
    assert Types.parse_listen("[::1]:1") == {:ok, {"::1", 1}}
    for bad <- ["", ":", ":65536", "host", "::1:1", "a b:1"], do: assert(Types.parse_listen(bad) == :error)
  end

  test "URLs of NATS servers" do
    for good <- ["nats://localhost", "nats://u:p@h:1", "tls://[::1]:4222"],
        do: assert({:ok, ^good} = Types.parse_nats_url(good))

    for bad <- ["localhost", "nats://", "http://h", "nats://h:99999", "nats://h/x?y"],
        do: assert(Types.parse_nats_url(bad) == :error)
  end
end
