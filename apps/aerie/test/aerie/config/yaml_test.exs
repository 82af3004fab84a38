defmodule Aerie.Config.YamlTest do
  use ExUnit.Case, async: true

  alias Aerie.Config.Yaml

  test "gives strings, numbers, booleans, nil, lists and maps; never atoms from the text" do
    text =
      "a: 1\nb: -2.5\nc: true\nd: null\ne: 'true'\nf: \"12\"\ng: [x, {y: z}]\nh:\ni: ''\nno_such_atom_at_all: no_such_one\n"

    assert Yaml.parse(text) ==
             {:ok,
              %{
                "a" => 1,
                "b" => -2.5,
                "c" => true,
                "d" => nil,
                "e" => "true",
                "f" => "12",
                "g" => ["x", %{"y" => "z"}],
                "h" => nil,
                "i" => "",
                "no_such_atom_at_all" => "no_such_one"
              }}
  end

  test "an empty file is an empty mapping; another top is an error" do
    assert Yaml.parse("") == {:ok, %{}}
    assert Yaml.parse("# nothing\n") == {:ok, %{}}
    assert {:error, %{expected: "keys with values" <> _}} = Yaml.parse("- 1\n")
    assert {:error, %{expected: "keys with values" <> _}} = Yaml.parse("just words\n")
    assert {:error, %{expected: "one YAML document"}} = Yaml.parse("a: 1\n---\nb: 2\n")
  end

  test "a key given twice is an error, with the line of the second one" do
    for {text, key, line} <- [
          {"a: 1\na: 2\n", "a", 2},
          {"policy:\n  max_altitude: 50\n  # max_altitude: 70\n  max_altitude: 500\n", "max_altitude", 4},
          {"policy: {max_altitude: 50}\nlabel: 'policy: x'\npolicy: {}\n", "policy", 3},
          {"links:\n  - {id: a, url: b}\n  - id: b\n    url: c\n    id: d\n", "id", 5},
          {"a: {b: 1, 'b': 2}\n", "b", 1},
          {"1: x\n\"1\": y\n", "1", 2},
          {"a: {b: 1}\nc: {b: 1, d: {b: 2}}\ne:\n  b: 1\n  b: 2\n", "b", 5}
        ] do
      got = ~s("#{key}" twice)
      assert {:error, %{expected: "each key once", got: ^got, line: ^line}} = Yaml.parse(text)
    end
  end

  test "a number that the parser cuts is an error: a key of many digits would be another one" do
    for digits <- ["12345678901234567890123", "-12345678901234567890123"] do
      assert {:error, %{line: 2, expected: "numbers of at most 18 digits" <> _}} =
               Yaml.parse("b: 1\na: #{digits}\n")

      assert {:ok, %{"a" => ^digits}} = Yaml.parse("a: '#{digits}'\n")
    end
  end

  test "keys have the line on which they stand; in doubt none" do
    text = """
    # policy: 1
    policy:
      max_altitude: 50 # max_altitude: 3
      "rates":
        - {types: [arm], per_minute: 3}
        - types: [takeoff]
          per_minute: 6
    label: "url: x"
    links: [{url: "tcp:a:1"},
            {url: "tcp:b:2"}]
    """

    lines = Yaml.lines(text)

    for {path, line} <- [
          {["policy"], 2},
          {["policy", "max_altitude"], 3},
          {["policy", "rates", 0, "types"], 5},
          {["policy", "rates", 1], 6},
          {["policy", "rates", 1, "per_minute"], 7},
          {["policy", "rates", 1, "types", 0], 6},
          {["policy", "no_such_key"], 2},
          {["links", 1, "url"], 10},
          {["nothing"], nil}
        ],
        do: assert(Yaml.Lines.at(lines, path) == line, inspect(path))

    assert Yaml.lines("a: |\n  b: 1\nb: 2\n") == %{["a"] => 1}
    assert Yaml.lines("a: [") == %{}
  end

  test "syntax errors and bytes that are not text give the line" do
    assert {:error, %{line: 3, expected: "valid YAML"}} = Yaml.parse("a: 1\nb: [1, 2\n")
    assert {:error, %{line: 2, expected: "UTF-8 text"}} = Yaml.parse("a: 1\nb: \xFF\xFE\n")
  end

  # Each of these ends the whole VM inside the C parser, or is silently misread, when it is let through.
  test "size, nesting and aliases are bounded" do
    assert {:error, %{expected: "at most" <> _}} = Yaml.parse(String.duplicate("# x\n", 100_000))
    assert {:error, %{expected: "at most 1000 brackets"}} = Yaml.parse(String.duplicate("[", 20_000))
    assert {:error, %{line: 1, expected: "lines of" <> _}} = Yaml.parse(String.duplicate("- ", 20_000) <> "x")
    assert {:error, %{line: 2, expected: "a plain value" <> _}} = Yaml.parse("a: &x [1, 2]\nb: *x\n")
    assert {:error, %{line: 2}} = Yaml.parse("a: &x {b: 1}\nc: {<<: *x, d: 1}\n")
    assert {:ok, %{"a" => "*x", "b" => "2*3"}} = Yaml.parse("a: '*x'\nb: 2*3 # *x\n")
  end

  test "any text gives a value or an error, never a crash" do
    chars = :proper_types.oneof([:proper_types.oneof(~c"abc:-[]{}&*!|>'\"%@`#,? \n\t"), :proper_types.byte()])

    property =
      :proper.forall(:proper_types.list(chars), fn bytes ->
        match?({tag, _} when tag in [:ok, :error], Yaml.parse(:erlang.list_to_binary(bytes)))
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end
end
