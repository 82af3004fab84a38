defmodule Aerie.CLI.Parser do
  @moduledoc "Parses the command line of `bin/aerie` into a request. Pure."

  alias Aerie.CLI.{Subcommand, Subcommands}

  @type result ::
          {:ok, Subcommand.t(), %{String.t() => String.t() | [String.t()]}, %{atom() => term()}}
          | {:help, Subcommand.t() | [Subcommand.t()]}
          | {:error, String.t()}

  @doc """
  Finds the subcommand, and checks its options and arguments. An error says what is wrong, what was expected, and where
  to look.
  """
  @spec command_line([String.t()]) :: result()
  def command_line([]), do: {:help, Subcommands.all()}
  def command_line([help | _rest]) when help in ["help", "--help", "-h"], do: {:help, Subcommands.all()}

  def command_line(words) do
    case find(words) do
      {row, rest} -> subcommand(row, rest)
      nil -> group(words)
    end
  end

  # `aerie params` is not a subcommand, and `aerie params --help` lists those below it.
  defp group([first | rest] = words) do
    case {below(first), rest} do
      {[_ | _] = rows, [help | _more]} when help in ["--help", "-h", "help"] -> {:help, rows}
      _other -> {:error, unknown(words)}
    end
  end

  defp below(first), do: for(row <- Subcommands.all(), String.starts_with?(row.name, first <> " "), do: row)

  # Two words before one: `config check` is a row, `config` alone is not one.
  defp find([first, second | rest] = words) do
    with nil <- row("#{first} #{second}", rest), do: find([first], tl(words))
  end

  defp find([first]), do: find([first], [])
  defp find([first], rest), do: row(first, rest)

  defp row(name, rest) do
    case Subcommands.fetch(name) do
      {:ok, row} -> {row, rest}
      :error -> nil
    end
  end

  defp unknown([first | _rest]) do
    case below(first) do
      [_ | _] = rows ->
        "#{first}: expected #{Enum.map_join(rows, ", ", & &1.name)}; see aerie #{first} --help"

      [] ->
        hint = closest(first, Enum.map(Subcommands.all(), & &1.name))
        "unknown command #{first}#{hint}; aerie --help lists the commands"
    end
  end

  # Where this VM got the words, the script has not started another one.
  defp subcommand(%{where: :script} = row, _rest), do: {:help, row}
  defp subcommand(row, rest), do: words(row, rest)

  @doc "Checks the words after the name of a subcommand."
  @spec words(Subcommand.t(), [String.t()]) :: result()
  def words(row, rest) do
    options = row.options ++ Subcommand.common(row)
    switches = [help: :boolean] ++ for {name, kind, _placeholder, _meaning} <- options, do: {name, kind}
    {given, arguments, invalid} = OptionParser.parse(rest, strict: switches, aliases: [h: :help, q: :quiet])

    cond do
      given[:help] ->
        {:help, row}

      invalid != [] ->
        {:error, invalid(row, hd(invalid), Keyword.keys(switches))}

      true ->
        with {:ok, arguments} <- arguments(row, arguments), do: {:ok, row, arguments, given(given, options)}
    end
  end

  defp given(given, options) do
    repeated =
      for {name, :keep, _placeholder, _meaning} <- options,
          values = Keyword.get_values(given, name),
          values != [],
          into: %{},
          do: {name, values}

    Map.merge(Map.new(given), repeated)
  end

  defp invalid(row, {name, nil}, known) do
    names = Enum.map(known, &Subcommand.switch/1)

    if name in names,
      do: "#{row.name}: #{name} needs a value#{see(row)}",
      else: "#{row.name}: unknown option #{name}#{closest(name, names)}#{see(row)}"
  end

  defp invalid(row, {name, value}, _known) do
    kind =
      for {option, :integer, _placeholder, _meaning} <- row.options,
          Subcommand.switch(option) == name,
          do: "whole "

    "#{row.name}: #{name}: '#{value}' is not a #{kind}number#{see(row)}"
  end

  defp see(row), do: "; see aerie #{row.name} --help"

  defp closest(word, known) do
    best = Enum.max_by(known, &String.jaro_distance(&1, word))
    if String.jaro_distance(best, word) > 0.75, do: "; did you mean #{best}?", else: ""
  end

  defp arguments(row, given), do: take(row.arguments, given, %{}, row)

  defp take([], [], taken, _row), do: {:ok, taken}
  defp take([], [word | _rest], _taken, row), do: {:error, "#{row.name}: unexpected '#{word}'#{see(row)}"}

  defp take([{name, _meaning} | rest], given, taken, row) do
    inner = name |> String.trim_leading("[") |> String.trim_trailing("]")
    plain = String.trim_trailing(inner, " ...")
    many? = inner != plain

    case {given, String.starts_with?(name, "[")} do
      {[], true} when many? -> take(rest, [], Map.put(taken, plain, []), row)
      {[], true} -> take(rest, [], taken, row)
      {[], false} -> {:error, "#{row.name}: #{plain} is missing: aerie #{Subcommand.usage(row)}"}
      {_words, _optional} when many? -> {:ok, Map.put(taken, plain, given)}
      {[word | given], _optional} -> take(rest, given, Map.put(taken, plain, word), row)
    end
  end
end
