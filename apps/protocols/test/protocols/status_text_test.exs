defmodule Protocols.StatusTextTest do
  use ExUnit.Case, async: true

  alias Protocols.StatusText
  alias MavCodec.Messages.Statustext

  @long String.duplicate("a", 50)

  defp chunk(id, n, text), do: %Statustext{severity: 4, id: id, chunk_seq: n, text: text}

  defp push(chunks) do
    Enum.reduce(chunks, {StatusText.new(), []}, fn {chunk, at}, {texts, given} ->
      {texts, new} = StatusText.push(texts, 1, chunk, at)
      {texts, given ++ Enum.map(new, & &1.text)}
    end)
  end

  test "a text without id is complete" do
    assert {_, ["ready"]} = push([{chunk(0, 0, "ready"), 0}])
    assert {_, [@long]} = push([{chunk(0, 0, @long), 0}])
  end

  test "X2: chunks until a short one" do
    assert {texts, [whole]} =
             push([{chunk(7, 0, @long), 0}, {chunk(7, 1, @long), 1}, {chunk(7, 2, "end"), 2}])

    assert whole == @long <> @long <> "end"
    assert texts.open == %{}
  end

  test "X2: the last chunk may be one character, a tab, or empty; the tab is not part of the text" do
    for {last, expected} <- [{")\t", @long <> ")"}, {"\t", @long}, {"", @long}] do
      assert {_, [^expected]} = push([{chunk(9, 0, @long), 0}, {chunk(9, 1, last), 1}])
    end
  end

  test "X2: texts that are interleaved, and chunks out of order" do
    assert {_, ["short", second, first]} =
             push([
               {chunk(1, 0, @long), 0},
               {chunk(2, 1, "second"), 1},
               {chunk(0, 0, "short"), 2},
               {chunk(2, 0, @long), 3},
               {chunk(1, 1, "first"), 4}
             ])

    assert {first, second} == {@long <> "first", @long <> "second"}
  end

  test "X2: a chunk that is missing for a second leaves a gap, wherever it is" do
    for {chunks, expected} <- [
          {[chunk(3, 0, @long), chunk(3, 2, "end")], @long <> "[…]end"},
          {[chunk(3, 1, "end")], "[…]end"},
          {[chunk(3, 0, @long)], @long <> "[…]"}
        ] do
      {texts, []} = push(Enum.map(chunks, &{&1, 5_000_000}))
      assert {^texts, []} = StatusText.expire(texts, 5_999_999)
      assert StatusText.deadline(texts) == 6_000_000

      assert {%{open: open}, [%{text: ^expected, at: 6_000_000, severity: 4}]} =
               StatusText.expire(texts, 9_000_000)

      assert open == %{}
    end
  end

  test "the same chunk twice (two links) is one; another text under the id ends the first" do
    assert {_, [whole]} = push([{chunk(4, 0, @long), 0}, {chunk(4, 0, @long), 1}, {chunk(4, 1, "x"), 2}])
    assert whole == @long <> "x"
    other = String.duplicate("b", 50)
    assert {_, [cut, next]} = push([{chunk(4, 0, @long), 0}, {chunk(4, 0, other), 1}, {chunk(4, 1, "x"), 2}])
    assert {cut, next} == {@long <> "[…]", other <> "x"}
  end

  test "one source's chunks are never put into another's text" do
    {texts, []} = StatusText.push(StatusText.new(), 1, chunk(5, 0, @long), 0)
    {_texts, given} = StatusText.push(texts, 100, chunk(5, 1, "x"), 0)
    assert given == []
  end

  test "incomplete texts are bounded" do
    {texts, given} = push(for id <- 1..100, do: {chunk(id, 0, @long), id})
    assert map_size(texts.open) == 16
    assert length(given) == 84
    {texts, _} = push(for n <- 0..255, do: {chunk(1, n, @long), n})
    assert map_size(texts.open) <= 1
  end

  test "bytes that are not UTF-8 are replaced" do
    assert {_, [text]} = push([{chunk(0, 0, <<"ok", 0xFF, "ok">>), 0}])
    assert String.valid?(text)
  end

  test "any text, cut into chunks in any order, comes back" do
    prop =
      :proper.forall({:proper_types.list(:proper_types.range(?a, ?z)), :proper_types.integer()}, fn {letters,
                                                                                                     seed} ->
        text = List.to_string(letters)
        chunks = for {part, n} <- Enum.with_index(parts(text)), do: {chunk(1, n, part), n}
        :rand.seed(:exsss, seed)
        {texts, given} = push(Enum.shuffle(chunks))
        texts.open == %{} and given == [text]
      end)

    assert :proper.quickcheck(prop, [:quiet, numtests: 200, max_size: 400]) == true,
           inspect(:proper.counterexample())
  end

  # As the firmwares cut: the last chunk is shorter than 50, empty if need be.
  defp parts(text) when byte_size(text) < 50, do: [text]
  defp parts(<<part::binary-size(50), rest::binary>>), do: [part | parts(rest)]
end
