defmodule Aerie.Api.Rest.Operations.Log.Get do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Base.Log

  @impl true
  def operation do
    level = %{enum: Log.level_names()}

    %Operation{
      name: "log.get",
      meaning: "Shows the levels of the log.",
      transfer?: false,
      answer: %{
        level: level,
        areas: %{type: :object, additionalProperties: level},
        levels: %{type: :array, items: level},
        known_areas: %{type: :array, items: %{type: :string}}
      },
      answer_as: "log",
      routes: [get("/api/log", "The levels of the log.")]
    }
  end

  @impl true
  def run(_input, _context),
    do: {:ok, Map.merge(Log.levels(), %{levels: Log.level_names(), known_areas: Log.areas()})}
end
