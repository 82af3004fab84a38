defmodule Aerie.Base.Json.SchemaTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Json
  alias Aerie.JsonSchemaCheck

  defp takes?(schema, value),
    do: schema |> JSON.encode!() |> JSON.decode!() |> JsonSchemaCheck.errors(value, %{}) == []

  test "a text that the schema takes is one that the gateway takes, of any characters" do
    for code <- Enum.concat([0..0x2FFF, 0xD7F0..0xD7FF, 0xE000..0xE010, 0xFFF0..0x10010]) do
      text = <<code::utf8>>
      assert takes?(Json.Schema.text(1), text) == Json.text?(text, 1, 1), inspect(code, base: :hex)
    end

    for text <- ["", "abc", "abcd", "äöü€", "ä€😀ß", "😀😀😀", "a\n"] do
      assert takes?(Json.Schema.text(3), text) == Json.text?(text, 1, 3), text
    end

    for other <- [nil, 1, [], <<0xFF>>], do: refute(Json.text?(other, 0, 3))
  end

  test "a text that is limited in bytes has no more of them" do
    schema = Json.Schema.bytes(8)
    for text <- ["a", "abcdefgh", "😀😀", "ä"], do: assert(takes?(schema, text))
    for text <- ["", "abcdefghi", "ääää", "a\0", nil], do: refute(takes?(schema, text))
  end

  test "null beside a type, a list of values and anything else" do
    assert Json.Schema.nullable(%{type: :string}) == %{type: [:string, :null]}
    assert Json.Schema.nullable(%{type: [:string, :null]}) == %{type: [:string, :null]}
    assert Json.Schema.nullable(%{enum: ["a"]}) == %{enum: ["a", nil]}
    assert %{anyOf: [%{const: 1}, %{type: :null}]} = Json.Schema.nullable(%{const: 1})
    assert %{anyOf: [%{"$ref": _where}, %{type: :null}]} = Json.Schema.nullable(Json.Schema.ref("x"))
  end

  test "the text of a document has its keys in order, and what fits on a line on one" do
    document = %{b: %{d: 1, c: [1, %{z: 1, y: 2}]}, a: String.duplicate("x", 120)}
    text = Json.Schema.pretty(document)
    assert JSON.decode!(text) == document |> JSON.encode!() |> JSON.decode!()

    assert [~s({), ~s(  "a": "x) <> _, ~s(  "b": {"c": [1, {"y": 2, "z": 1}], "d": 1}), ~s(}), ""] =
             String.split(text, "\n")
  end
end
