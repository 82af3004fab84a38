defmodule Aerie.Console.Pages.Fleet.Filter do
  @moduledoc """
  Chooses which vehicles the page shows. Pure. The filter is part of the page's address, so that it survives a reload and can be shared.
  """

  alias Aerie.Console.Pages.Fleet.Board.Row
  alias Aerie.Vehicle.Firmware

  @flags ~w(armed air unready stale problem)a
  @max 64

  defstruct search: "", type: nil, firmware: nil, tag: nil, flags: []

  @typedoc """
    * `:search` - words, each of which must occur in the id, the mode, the type or a tag, or be the system id
    * `:flags` - `:armed`, `:air` (in the air), `:unready` (on the ground, not ready or unknown), `:stale` (stale
      or lost), `:problem`; all must apply
  """
  @type t :: %__MODULE__{
          search: String.t(),
          type: String.t() | nil,
          firmware: String.t() | nil,
          tag: String.t() | nil,
          flags: [atom()]
        }

  @doc "The flags with their labels."
  @spec flags() :: [{String.t(), String.t()}]
  def flags,
    do: [
      {"armed", "Armed"},
      {"air", "In air"},
      {"unready", "Not ready"},
      {"stale", "Stale"},
      {"problem", "Has problems"}
    ]

  @doc "The filter in an address. Unknown parameters are ignored."
  @spec parse(map()) :: t()
  def parse(params) do
    %__MODULE__{
      search: text(params["q"]) || "",
      type: text(params["type"]),
      firmware: text(params["firmware"]),
      tag: text(params["tag"]),
      flags: for(flag <- @flags, params[Atom.to_string(flag)] == "1", do: flag)
    }
  end

  @doc "The parameters for the address; `parse/1` reads them back."
  @spec params(t()) :: [{String.t(), String.t()}]
  def params(filter) do
    texts = [{"q", filter.search}, {"type", filter.type}, {"firmware", filter.firmware}, {"tag", filter.tag}]

    for({name, value} <- texts, value not in [nil, ""], do: {name, value}) ++
      for flag <- filter.flags, do: {Atom.to_string(flag), "1"}
  end

  @doc "Toggles a flag by its name; an unknown name changes nothing."
  @spec toggle(t(), String.t()) :: t()
  def toggle(filter, name) do
    case Enum.find(@flags, &(Atom.to_string(&1) == name)) do
      nil -> filter
      flag -> %{filter | flags: for(one <- @flags, one in filter.flags != (one == flag), do: one)}
    end
  end

  @doc "Whether anything is filtered."
  @spec any?(t()) :: boolean()
  def any?(filter), do: params(filter) != []

  @doc "Whether the filter shows a vehicle."
  @spec shows?(t(), Row.t()) :: boolean()
  def shows?(%__MODULE__{search: "", type: nil, firmware: nil, tag: nil, flags: []}, _row), do: true

  def shows?(filter, row) do
    Enum.all?(filter.flags, &flag?(&1, row)) and filter.type in [nil, row.kind] and
      filter.firmware in [nil, Atom.to_string(row.autopilot)] and
      (filter.tag == nil or filter.tag in row.tags) and
      found?(filter.search, row)
  end

  defp flag?(:armed, row), do: row.armed == true
  defp flag?(:air, row), do: row.in_air == true
  defp flag?(:unready, row), do: row.readiness in [:not_ready, :unknown]
  defp flag?(:stale, row), do: row.status != :online
  defp flag?(:problem, row), do: row.problems != []

  defp found?("", _row), do: true

  defp found?(search, row) do
    words = [row.id, row.mode, Firmware.meaning(row.mode), row.kind, row.autopilot | row.tags]
    hay = words |> Enum.join(" ") |> String.downcase()
    system = Integer.to_string(row.system_id)
    search |> String.downcase() |> String.split() |> Enum.all?(&(&1 == system or String.contains?(hay, &1)))
  end

  defp text(value) when is_binary(value) and value != "" do
    if String.valid?(value), do: String.slice(value, 0, @max)
  end

  defp text(_none), do: nil
end
