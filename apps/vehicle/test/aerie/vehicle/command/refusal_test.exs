defmodule Aerie.Vehicle.Command.RefusalTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Command.Refusal
  alias Aerie.Vehicle.Command.Refusal.{Unknown, Vehicle}

  @apps Path.expand("../../../../..", __DIR__)

  test "each call gives a reason of the table and a value for each of its holes; each text is said by somebody" do
    calls = calls()
    assert Enum.reject(calls, fn {_file, reason, values} -> values == holes(reason) end) == []
    assert Map.keys(Refusal.texts()) -- Enum.map(calls, fn {_file, reason, _values} -> reason end) == []
  end

  test "no reason and no rule has two rows" do
    rows =
      Enum.map(Refusal.table(), & &1.texts) ++ Enum.map(Vehicle.ends(), &elem(&1, 1)) ++ [Unknown.texts()]

    reasons = rows |> Enum.concat() |> Keyword.keys()
    assert reasons == Enum.uniq(reasons)
    rules = Enum.map(Refusal.table(), & &1.rule)
    assert rules == Enum.uniq(rules)
  end

  test "a value is not read as a hole" do
    assert Refusal.deny(:number, command: "%{wrong}", wrong: "no number") ==
             {:deny, :number, "%{wrong}: no number"}
  end

  defp holes(reason),
    do:
      Refusal.texts()
      |> Map.get(reason, [:no_such_reason])
      |> Enum.filter(&is_atom/1)
      |> Enum.uniq()
      |> Enum.sort()

  defp calls do
    for file <- Path.wildcard(Path.join(@apps, "*/lib/**/*.ex")),
        text = File.read!(file),
        text =~ "Refusal.",
        call <- text |> Code.string_to_quoted!() |> calls(Path.relative_to(file, @apps)),
        do: call
  end

  defp calls(ast, file) do
    {_ast, found} =
      Macro.prewalk(ast, [], fn
        {{:., _, [{:__aliases__, _, names}, called]}, _, arguments} = node, found
        when called in [:deny, :text, :ended] ->
          if List.last(names) == :Refusal and not match?([{:reason, _, nil}], arguments),
            do: {node, [call(file, arguments) | found]},
            else: {node, found}

        # What machines give, by their own names for it.
        {:@, _, [{:ends, _, [{:sigil_w, _, [{:<<>>, _, [names]}, ~c"a"]}]}]} = node, found ->
          {node, Enum.map(String.split(names), &{file, String.to_atom(&1), []}) ++ found}

        node, found ->
          {node, found}
      end)

    found
  end

  # Values that are not written there are nothing that a test can read, and fit no text.
  defp call(file, [reason]), do: {file, reason, []}

  defp call(file, [reason, values]),
    do:
      {file, reason, if(Keyword.keyword?(values), do: values |> Keyword.keys() |> Enum.sort(), else: values)}
end
