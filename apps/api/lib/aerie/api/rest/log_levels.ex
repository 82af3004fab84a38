defmodule Aerie.Api.Rest.LogLevels do
  @moduledoc """
  `GET` and `PATCH /api/log`: from which level on the log is written.

      {"level": "debug"}
      {"areas": {"mav_router": "debug", "gnat": null}}

  null: the area follows `level` again. The log belongs to the process of the gateway; a restart brings the configured level back.
  """

  alias Aerie.Base.Log
  alias Aerie.Access.HTTP.{Error, Request}

  @levels Map.new(Log.level_names(), &{Atom.to_string(&1), &1})

  @doc "The levels as an answer."
  @spec view() :: map()
  def view, do: Map.merge(Log.levels(), %{levels: Log.level_names(), known_areas: Log.areas()})

  @doc "Checks a body completely, then changes the levels; gives them."
  @spec change(map()) :: {:ok, map()} | {:error, Error.t()}
  def change(object) do
    with {:ok, changes} <- parse(object) do
      # An area whose application does not run here has nothing to log.
      for change <- changes do
        _ =
          case change do
            {:all, level} -> Log.set_level(level)
            {area, nil} -> Log.reset(area)
            {area, level} -> Log.set_level(area, level)
          end
      end

      {:ok, view()}
    end
  end

  @doc "The changes that a body asks for. Pure."
  @spec parse(map()) :: {:ok, [{:all | String.t(), Log.level() | nil}]} | {:error, Error.t()}
  def parse(object) when object == %{}, do: Error.invalid("nothing to change; give level or areas")

  def parse(object) do
    Enum.reduce_while(object, {:ok, []}, fn pair, {:ok, changes} ->
      case changes(pair) do
        {:ok, more} -> {:cont, {:ok, changes ++ more}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  defp changes({"level", name}) do
    with {:ok, level} <- level(name), do: {:ok, [{:all, level}]}
  end

  defp changes({"areas", areas}) when is_map(areas) do
    Enum.reduce_while(areas, {:ok, []}, fn {area, name}, {:ok, changes} ->
      with true <- area in Log.areas() || Request.unknown(area, Log.areas()),
           {:ok, level} <- if(name == nil, do: {:ok, nil}, else: level(name)) do
        {:cont, {:ok, [{area, level} | changes]}}
      else
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  defp changes({"areas", _other}), do: Error.invalid("areas must be an object of names and levels")
  defp changes({name, _value}), do: Request.unknown(name, ["areas", "level"])

  defp level(name) do
    with :error <- Map.fetch(@levels, name),
         do: Error.invalid("a level is one of #{Enum.map_join(Log.level_names(), ", ", &to_string/1)}")
  end
end
