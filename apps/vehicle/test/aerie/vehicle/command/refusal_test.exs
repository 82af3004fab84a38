defmodule Aerie.Vehicle.Command.RefusalTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Vehicle.Command.Refusal.{Unknown, Vehicle}

  @apps Path.expand("../../../../..", __DIR__)
  # `:unknown` is also what is not known of a vehicle.
  @statuses Enum.map(Result.table(), &elem(&1, 0)) -- [:unknown]

  setup_all do
    files = Path.wildcard(Path.join(@apps, "{vehicle,control,fleet,access,api,console,aerie}/lib/**/*.ex"))

    %{
      sources:
        for(
          file <- files,
          do: {Path.relative_to(file, @apps), file |> File.read!() |> Code.string_to_quoted!()}
        )
    }
  end

  test "each call gives a reason of the table and a value for each of its holes; each text is said by somebody",
       %{sources: sources} do
    calls = for {file, ast} <- sources, call <- found(ast, &call/1), do: {file, call}
    assert Enum.reject(calls, fn {_file, {reason, values}} -> values == holes(reason) end) == []
    assert Map.keys(Refusal.texts()) -- Enum.map(calls, fn {_file, {reason, _values}} -> reason end) == []
  end

  # A firmware's own are in its folder, those of plans beside their transfer.
  test "no refusal and no end has its text beside the table", %{sources: sources} do
    beside =
      for {file, ast} <- sources,
          not String.contains?(file, ["/firmware/", "/refusal/"]),
          text <- found(ast, &beside/1),
          do: {file, text}

    assert beside == []
  end

  test "no reason and no rule has two rows" do
    rows =
      Enum.map(Refusal.table(), & &1.texts) ++ Enum.map(Vehicle.ends(), &elem(&1, 1)) ++ [Unknown.texts()]

    for names <- [rows |> Enum.concat() |> Keyword.keys(), Enum.map(Refusal.table(), & &1.rule)],
        do: assert(names == Enum.uniq(names))
  end

  test "a value is not read as a hole" do
    assert Refusal.deny(:number, command: "%{wrong}", wrong: "no number") ==
             {:deny, :number, "%{wrong}: no number"}
  end

  defp found(ast, what), do: ast |> Macro.prewalker() |> Enum.flat_map(what)

  # A reason with its values. Those that are not written there are nothing that a test can read, and fit no text.
  defp call({{:., _, [{:__aliases__, _, names}, called]}, _, [reason | values]})
       when called in [:deny, :text, :ended],
       do: if(List.last(names) == :Refusal, do: List.wrap(given(reason, values)), else: [])

  # What machines give, by their own names for it.
  defp call({:@, _, [{:ends, _, [{:sigil_w, _, [{:<<>>, _, [names]}, ~c"a"]}]}]}),
    do: for(name <- String.split(names), do: {String.to_atom(name), []})

  defp call(_other), do: []

  defp given({:reason, _, nil}, []), do: nil
  defp given(reason, []), do: {reason, []}

  defp given(reason, [values]),
    do: {reason, Keyword.keyword?(values) && values |> Keyword.keys() |> Enum.sort()}

  defp holes(reason) do
    Refusal.texts()
    |> Map.get(reason, [:no_such_reason])
    |> Enum.filter(&is_atom/1)
    |> Enum.uniq()
    |> Enum.sort()
  end

  defp beside({:{}, _, [:deny | values]}), do: Enum.filter(values, &text?/1)
  defp beside({status, text}) when status in @statuses, do: Enum.filter([text], &text?/1)

  defp beside({{:., _, [_module, :new]}, _, [_id, status, text | _]}) when status in [:unknown | @statuses],
    do: Enum.filter([text], &text?/1)

  defp beside(_other), do: []

  defp text?({:<>, _, [text, _more]}), do: text != ""
  defp text?({operator, _, _}), do: operator == :<<>>
  defp text?(value), do: is_binary(value)
end
