defmodule Aerie.Console.Pages.Inspector.Rows do
  @moduledoc "The rows of the inspector as the page shows them: named, filtered, sorted, bounded. Pure."

  alias Aerie.Fleet.Inspector

  @max_rows 200

  @typedoc "The filter: texts for `text`, `link`, `vehicle` (`NETWORK/SYSTEM`), `component`, `direction`; empty for all."
  @type filter :: %{String.t() => String.t()}

  @typedoc "`id` is for the page; `vehicle` is the public id, or network and system if there is none."
  @type row :: %{
          id: String.t(),
          key: Inspector.key(),
          name: String.t(),
          vehicle: String.t(),
          hz: float(),
          count: pos_integer(),
          age_us: integer() | nil
        }

  @doc "The filter of an empty form."
  @spec all() :: filter()
  def all, do: %{"text" => "", "link" => "", "vehicle" => "", "component" => "", "direction" => ""}

  @doc "The filter of a page that is opened: what is received. What the gateway forwards would list every message twice."
  @spec received() :: filter()
  def received, do: %{all() | "direction" => "in"}

  @doc "A filter from what a browser sent: only known keys, short texts."
  @spec filter(map()) :: filter()
  def filter(params) do
    Map.new(all(), fn {key, none} ->
      value = params[key]
      {key, if(is_binary(value), do: String.slice(value, 0, 100), else: none)}
    end)
  end

  @doc """
  The rows, and how many more there are. `networks` are those of the links, `vehicles` the public ids by `{network, system}`; `now` in unix
  microseconds.
  """
  @spec rows(
          [Inspector.row()],
          filter(),
          %{String.t() => String.t()},
          map(),
          {atom(), :asc | :desc},
          integer()
        ) ::
          {[row()], non_neg_integer()}
  def rows(rows, filter, networks, vehicles, sort, now) do
    shown =
      for %{key: {link, direction, system, component, id} = key, name: name} = row <- rows,
          network = Map.get(networks, link, "?"),
          same?(link, filter["link"]) and same?(Atom.to_string(direction), filter["direction"]) and
            same?("#{network}/#{system}", filter["vehicle"]) and same?("#{component}", filter["component"]) and
            named?(name, id, filter["text"]) do
        %{
          id: row_id(key),
          key: key,
          name: name,
          vehicle: Map.get(vehicles, {network, system}, "#{network}/#{system}"),
          hz: row.hz,
          count: row.count,
          age_us: row.at && max(now - row.at, 0)
        }
      end

    {sorted(shown, sort) |> Enum.take(@max_rows), max(length(shown) - @max_rows, 0)}
  end

  defp same?(_value, ""), do: true
  defp same?(value, wanted), do: value == wanted

  defp named?(_name, _id, ""), do: true
  defp named?(name, id, text), do: String.contains?(name, String.upcase(text)) or "#{id}" == text

  # Equal rows are in the order of their keys, so that they do not jump.
  defp sorted(rows, {:name, order}), do: Enum.sort_by(rows, &{&1.name, &1.key}, order)
  defp sorted(rows, {:hz, order}), do: Enum.sort_by(rows, &Float.round(&1.hz, 0), order)
  defp sorted(rows, {:vehicle, order}), do: Enum.sort_by(rows, &{&1.vehicle, &1.name, &1.key}, order)
  defp sorted(rows, {:link, order}), do: Enum.sort_by(rows, &{elem(&1.key, 0), &1.name, &1.key}, order)

  @doc "The id of a row in the page; the key itself may contain any text."
  @spec row_id(Inspector.key()) :: String.t()
  def row_id({link, direction, system, component, id}),
    do: "m-#{:erlang.phash2(link)}-#{direction}-#{system}-#{component}-#{id}"

  @doc "The choices of the filter: links, vehicles with their names, components."
  @spec choices([Inspector.row()], %{String.t() => String.t()}, map()) :: %{
          atom() => [{String.t(), String.t()}]
        }
  def choices(rows, networks, vehicles) do
    keys = Enum.map(rows, & &1.key)

    systems =
      for {link, _direction, system, _component, _id} <- keys,
          network = Map.get(networks, link, "?"),
          uniq: true do
        {Map.get(vehicles, {network, system}, "#{network}/#{system}"), "#{network}/#{system}"}
      end

    %{
      link: for(link <- keys |> Enum.map(&elem(&1, 0)) |> Enum.uniq() |> Enum.sort(), do: {link, link}),
      vehicle: Enum.sort(systems),
      component: for(n <- keys |> Enum.map(&elem(&1, 3)) |> Enum.uniq() |> Enum.sort(), do: {"#{n}", "#{n}"})
    }
  end
end
