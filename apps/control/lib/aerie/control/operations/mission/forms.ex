defmodule Aerie.Control.Operations.Mission.Forms do
  @moduledoc "The forms of a plan: an object as in a `.plan` file, or a file of one of several programs."

  import Aerie.Base.Json.Schema

  alias Aerie.Control.Missions

  @readers %{"plan" => :plan, "waypoints" => :waypoints, "mission" => :mission}

  @doc "The forms that a plan of a kind may have, JSON first."
  @spec all(Missions.kind()) :: [String.t(), ...]
  def all(:mission), do: ["json", "waypoints", "plan", "mission"]
  def all(_other), do: ["json", "plan"]

  @doc "The path, name and forms of each kind over REST."
  @spec routes((path :: String.t(), name :: String.t(), keyword() -> route)) :: [route] when route: term()
  def routes(make) do
    for {kind, name} <- [mission: "mission", fence: "fence", rally: "rally points"],
        do: make.("/api/vehicles/:id/#{kind}", name, given: %{"kind" => "#{kind}"}, formats: all(kind))
  end

  @doc "The plan of a file."
  @spec read(format :: String.t(), binary()) :: {:ok, Protocols.Mission.Plan.t()} | {:error, String.t()}
  def read(format, text), do: Missions.import(text, Map.fetch!(@readers, format))

  @doc "A stored plan in one of the forms: an object, or the text of a file."
  @spec write(format :: String.t(), Missions.stored(), Missions.kind(), vehicle :: String.t()) ::
          {:ok, map() | {:file, String.t(), iodata()}} | {:error, {:invalid, String.t()}}
  def write("json", stored, kind, _vehicle), do: {:ok, Missions.plain(stored, kind)}

  def write(format, stored, kind, vehicle) do
    case Missions.export(stored.plan, Map.fetch!(@readers, format)) do
      {:ok, text} -> {:ok, {:file, "#{vehicle}-#{kind}.#{format}", text}}
      {:error, reason} -> {:error, {:invalid, reason}}
    end
  end

  @doc "A .plan file of QGroundControl as an object. Which items and shapes it may have is in docs/transfers.md."
  @spec schema() :: Aerie.Base.Json.Schema.t()
  def schema do
    object(
      %{
        fileType: %{const: "Plan"},
        version: %{const: 1},
        mission: section([:items]),
        geoFence: section([:polygons, :circles]),
        rallyPoints: section([:points])
      },
      [:fileType],
      open: true
    )
  end

  defp section(lists), do: object(Map.new(lists, &{&1, %{type: :array}}), [], open: true)
end
