defmodule Bench.Options do
  @moduledoc """
  The options of a benchmark's command line.

      options = Bench.Options.read(__ENV__.file, seconds: 3, quick: false, clients: "1,5")

  Options are given with their defaults, from which their types follow; `:integer` is one without a default. `--help`
  prints the comment at the head of the file, and anything unknown is refused with a list of what there is.
  """

  @type default :: integer() | boolean() | String.t() | :integer

  @doc "The options by name. Ends the program after `--help` (0) and after what it does not know (2)."
  @spec read(Path.t(), keyword(default())) :: keyword()
  def read(file, defaults) do
    case parse(System.argv(), defaults) do
      {:ok, options} ->
        options

      :help ->
        IO.puts(head(File.read!(file)))
        System.halt(0)

      {:error, text} ->
        IO.puts(:stderr, "#{Path.basename(file, ".exs")}: #{text}")
        System.halt(2)
    end
  end

  @doc "The same without its effects."
  @spec parse([String.t()], keyword(default())) :: {:ok, keyword()} | :help | {:error, String.t()}
  def parse(argv, defaults) do
    types = for {name, default} <- defaults, do: {name, type(default)}

    {options, others, wrong} =
      OptionParser.parse(argv, strict: [help: :boolean] ++ types, aliases: [h: :help])

    case {wrong, others} do
      {[{name, nil} | _], _} -> {:error, "#{name} is unknown or lacks its value; #{known(types)}"}
      {[{name, value} | _], _} -> {:error, "#{name} cannot be #{value}; #{known(types)}"}
      {[], [other | _]} -> {:error, "#{other} is not an option; #{known(types)}"}
      {[], []} -> if options[:help], do: :help, else: {:ok, Keyword.merge(given(defaults), options)}
    end
  end

  defp given(defaults), do: Enum.reject(defaults, &match?({_name, :integer}, &1))

  defp type(default) when is_integer(default) or default == :integer, do: :integer
  defp type(default) when is_boolean(default), do: :boolean
  defp type(default) when is_binary(default), do: :string

  defp known(types) do
    "options: " <>
      Enum.map_join(types ++ [help: :boolean], ", ", fn
        {name, :boolean} -> "--#{name}"
        {name, :integer} -> "--#{name} N"
        {name, :string} -> "--#{name} TEXT"
      end)
  end

  @doc "The numbers of a list as an option has it: `10,50,200`."
  @spec numbers(String.t()) :: [integer()]
  def numbers(text), do: text |> String.split(",", trim: true) |> Enum.map(&String.to_integer/1)

  # The comment lines that the file begins with.
  defp head(text) do
    text
    |> String.split("\n")
    |> Enum.take_while(&String.starts_with?(&1, "#"))
    |> Enum.map_join("\n", &String.replace(&1, ~r/\A# ?/, ""))
  end
end
