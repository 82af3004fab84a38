defmodule Aerie.Control.Operations do
  @moduledoc """
  All operations of a vehicle that are not commands: parameters, plans, files, logs
  (`Aerie.Control.Operations.Operation`). A new one is a file in `operations/` and a line here.
  """

  alias Aerie.Control.Operations.{Files, Logs, Mission, Params}

  use Aerie.Control.Operations.Table, [
    Params.List,
    Params.Get,
    Params.Set,
    Params.Load,
    Params.Metadata,
    Mission.Get,
    Mission.Put,
    Mission.Clear,
    Files.Read,
    Files.List,
    Files.Crc,
    Files.Write,
    Files.Remove,
    Logs.List,
    Logs.Read
  ]

  @doc "The first words of their names: what is subscribed to beside commands."
  @spec areas() :: [String.t()]
  def areas, do: all() |> Enum.map(&area/1) |> Enum.uniq()

  @doc "The names in an area."
  @spec names(area :: String.t()) :: [String.t()]
  def names(area), do: for(operation <- all(), area(operation) == area, do: operation.name)

  defp area(%{name: name}), do: name |> String.split(".") |> hd()

  @doc "The schemas that those of requests and answers refer to, by their names."
  @spec shared() :: %{String.t() => Aerie.Base.Json.Schema.t()}
  def shared, do: %{"plan" => Mission.Forms.schema()}
end
