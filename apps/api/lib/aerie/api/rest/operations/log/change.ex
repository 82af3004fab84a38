defmodule Aerie.Api.Rest.Operations.Log.Change do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Api.Rest.Operations.Log.Get
  alias Aerie.Base.Log

  @levels Map.new(Log.level_names(), &{Atom.to_string(&1), &1})

  @impl true
  def operation do
    %Operation{
      name: "log.change",
      meaning: "Changes the levels of the log until the next start.",
      transfer?: false,
      closed?: true,
      fields: [field(:level, {:enum, Log.level_names()}, "the level of everything"), areas()],
      rules: [minProperties: 1],
      answer: Get.operation().answer,
      answer_as: "log",
      routes: [patch("/api/log", "Changes the levels of the log.", change: :change_log)]
    }
  end

  defp areas do
    schema = object(Map.new(Log.areas(), &{&1, nullable(%{enum: Log.level_names()})}))
    names = fn names -> Enum.join(names, ", ") end

    words =
      "an object of areas (#{names.(Log.areas())}), each with a level (#{names.(Log.level_names())}) or null"

    field(:areas, {:term, &read_areas/1, words}, "areas with a level of their own; null ends it",
      schema: schema
    )
  end

  defp read_areas(%{} = areas) do
    known? = fn {area, level} -> area in Log.areas() and (level == nil or is_map_key(@levels, level)) end

    if Enum.all?(areas, known?),
      do: {:ok, Map.new(areas, fn {area, level} -> {area, @levels[level]} end)},
      else: :error
  end

  defp read_areas(_other), do: :error

  @impl true
  def run(%{level: nil, areas: nil}, _context),
    do: {:error, {:invalid, "nothing to change; give level or areas"}}

  def run(%{level: level, areas: areas}, context) do
    if level, do: Log.set_level(level)

    # An area whose application does not run here has nothing to log.
    Enum.each(areas || %{}, fn {area, level} ->
      if level, do: Log.set_level(area, level), else: Log.reset(area)
    end)

    Get.run(%{}, context)
  end
end
