defmodule Phoenix.LiveView.QueryTest do
  use ExUnit.Case, async: true

  alias Phoenix.LiveView.{Query, Token}

  for {query, params} <- [
        {"", %{}},
        {"a=1&b", %{"a" => "1", "b" => ""}},
        {"a[b]=1&a[c][]=2&a[c][]=3", %{"a" => %{"b" => "1", "c" => ["2", "3"]}}},
        {"a=%C3%A4+x%26", %{"a" => "ä x&"}},
        {"a=1&a[b]=2", %{"a" => %{"b" => "2"}}},
        {"a[]=1&a[b]=2&a[]=3", %{"a" => ["3"]}}
      ] do
    test "#{query} is #{inspect(params)}",
      do: assert(Query.decode(unquote(query)) == {:ok, unquote(Macro.escape(params))})
  end

  test "what is not text, too much or too deep is an error" do
    assert {:error, _} = Query.decode("a=%FF")
    assert {:error, _} = Query.decode(String.duplicate("a=1&", 2_001))
    assert {:error, _} = Query.decode("a" <> String.duplicate("[b]", 12) <> "=1")
  end

  test "any text is parameters or an error" do
    assert :proper.quickcheck(
             :proper.forall(:proper_types.list(:proper_types.oneof(~c"a[]=&%0f")), fn text ->
               case Query.decode(List.to_string(text)) do
                 {:ok, params} -> is_map(params)
                 {:error, words} -> is_binary(words)
               end
             end),
             [:quiet, {:numtests, 2_000}]
           ) == true
  end

  test "a token is good for its purpose, its key and its time" do
    key = String.duplicate("k", 32)
    token = Token.sign(key, "a", %{b: 1}, 1_000)
    assert Token.verify(key, "a", token, 60, 1_060) == {:ok, %{b: 1}}
    assert Token.verify(key, "a", token, 60, 1_061) == {:error, :expired}
    assert Token.verify(key, "b", token, 60, 1_000) == {:error, :invalid}
    assert Token.verify("other" <> key, "a", token, 60, 1_000) == {:error, :invalid}

    for wrong <- [nil, "", "a.b", token <> "x", "x" <> token, 1],
        do: assert(Token.verify(key, "a", wrong, 60, 1_000) == {:error, :invalid})
  end
end
