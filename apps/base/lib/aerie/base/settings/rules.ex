defmodule Aerie.Base.Settings.Rules do
  @moduledoc "Words for what is wrong with several keys together (`c:Aerie.Base.Settings.problems/1`)."

  alias Aerie.Base.Settings.Schema

  @doc "A problem at a path."
  @spec problem(Schema.path(), String.t(), String.t(), String.t() | nil) :: Schema.problem()
  def problem(path, expected, got, hint \\ nil), do: %{path: path, expected: expected, got: got, hint: hint}

  @doc "The problems among checks: `{wrong?, path, expected, got}`."
  @spec failed([{boolean(), Schema.path(), String.t(), String.t()}]) :: [Schema.problem()]
  def failed(checks), do: for({true, path, expected, got} <- checks, do: problem(path, expected, got))

  @doc "The texts among `{applies?, text}`."
  @spec texts([{boolean(), String.t()}]) :: [String.t()]
  def texts(checks), do: for({true, text} <- checks, do: text)

  @doc "Names that several items have."
  @spec twice([item], (item -> String.t()), Schema.path(), String.t()) :: [Schema.problem()] when item: term()
  def twice(items, name, path, expected) do
    for {name, [_, _ | _]} <- Enum.group_by(items, name),
        do: problem(path, expected, "\"#{name}\" more than once")
  end
end
