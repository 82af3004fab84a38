defmodule Aerie.Fleet.Parts do
  @moduledoc "What `Aerie.Gateway` needs of the fleet's parts: their settings, their tables, and those that start last."

  alias Aerie.Base.Store
  alias Aerie.Fleet.{Bridge, Client, Remote, Shadow, Tracks}

  @doc "The settings, for the schema of the configuration."
  @spec settings() :: [module()]
  def settings,
    do: [Bridge.Settings, Remote.Settings, Tracks.Settings, Shadow.Settings, Client.Settings]

  @doc "The tables that the store owns."
  @spec tables() :: [Store.table()]
  def tables, do: [Remote.Table.table(), Tracks.Files.table()]

  @doc "The parts that start after the links, with their options."
  @spec last(config :: map()) :: [{module(), keyword()}]
  def last(config) do
    [
      {Client.Supervisor, settings: Client.Settings.from(config)},
      {Tracks.Server, settings: Tracks.Settings.from(config)}
    ]
  end
end
