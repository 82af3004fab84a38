defmodule Aerie.Console.Pages.Vehicle.Sections do
  @moduledoc "The sections of a vehicle's page, and their paths."

  @all [
    {"fly", "Fly", "heading"},
    {"commands", "Commands", "list"},
    {"events", "Events", "clock"},
    {"charts", "Charts", "chart"},
    {"health", "Health", "diagnosis"},
    {"links", "Links", "signal"}
  ]

  @doc "Name, label and icon of each, in the order of the tabs."
  @spec all() :: [{String.t(), String.t(), String.t()}]
  def all, do: @all

  @doc "Whether a section has this name."
  @spec section?(term()) :: boolean()
  def section?(name), do: List.keymember?(@all, name, 0)

  @doc "The path of a section of a vehicle's page."
  @spec path(vehicle :: String.t(), String.t()) :: String.t()
  def path(id, "fly"), do: "/vehicles/#{URI.encode(id, &URI.char_unreserved?/1)}"
  def path(id, section), do: "#{path(id, "fly")}/#{section}"

  @doc "The path of a command's form."
  @spec command_path(vehicle :: String.t(), type :: String.t()) :: String.t()
  def command_path(id, type), do: path(id, "commands") <> "?c=#{type}"

  @doc "The path of the charts of fields, by their keys."
  @spec charts_path(vehicle :: String.t(), [String.t()]) :: String.t()
  def charts_path(id, keys), do: path(id, "charts") <> "?f=#{Enum.join(keys, ",")}"
end
