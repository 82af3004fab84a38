defmodule Aerie.Containerfile do
  @moduledoc """
  Reads a Containerfile as far as that of `rel/container` needs it: comments, continued lines, stages. For its test, and for
  `test/install/image.exs`, which does its steps without an engine. It uses nothing of Aerie.
  """

  @typedoc "A stage: its base, the name that others copy from it by, and its instructions in order."
  @type stage :: %{
          from: String.t(),
          name: String.t() | nil,
          steps: [{word :: String.t(), flags :: %{String.t() => String.t()}, rest :: String.t()}]
        }

  @doc "The stages of a Containerfile, in order. Raises on what engines would refuse, too: an instruction before FROM."
  @spec parse(String.t()) :: [stage()]
  def parse(text) do
    text
    |> String.split("\n")
    |> Enum.reject(&(&1 =~ ~r/^\s*(#|$)/))
    |> Enum.join("\n")
    |> String.replace(~r/\\\n\s*/, "")
    |> String.split("\n")
    |> Enum.reduce([], &instruction/2)
    |> Enum.map(&%{&1 | steps: Enum.reverse(&1.steps)})
    |> Enum.reverse()
  end

  defp instruction("FROM " <> rest, stages) do
    [from | name] = String.split(rest, ~r/ +AS +/i)
    [%{from: from, name: List.first(name), steps: []} | stages]
  end

  defp instruction(line, [stage | stages]) do
    [word, rest] = String.split(line, " ", parts: 2)
    {flags, rest} = flags(rest, %{})
    [%{stage | steps: [{word, flags, rest} | stage.steps]} | stages]
  end

  defp flags(rest, flags) do
    case Regex.run(~r/\A--([a-z-]+)=(\S+) +(.*)\z/s, rest) do
      [_all, name, value, rest] -> flags(rest, Map.put(flags, name, value))
      nil -> {flags, rest}
    end
  end

  @doc "The words of a command: of the JSON form those in it, of the other one a shell with it."
  @spec command(String.t()) :: [String.t()]
  def command("[" <> _rest = json), do: JSON.decode!(json)
  def command(text), do: ["/bin/sh", "-c", text]

  @doc "The last value of an instruction in a stage, nil if it has none."
  @spec last(stage(), String.t()) :: String.t() | nil
  def last(stage, word),
    do:
      Enum.reduce(stage.steps, nil, fn {name, _flags, rest}, last -> if name == word, do: rest, else: last end)

  @doc "What the `ENV` of a stage set."
  @spec env(stage()) :: %{String.t() => String.t()}
  def env(stage) do
    for {"ENV", _flags, rest} <- stage.steps, pair <- String.split(rest), into: %{} do
      [name, value] = String.split(pair, "=", parts: 2)
      {name, value}
    end
  end
end
