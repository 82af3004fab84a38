defmodule MavCodec.Definition.Enumerations do
  @moduledoc "Enums of one name in several sources become one module. Two sources may name one value differently."

  alias MavCodec.Definition.{Error, Naming}
  alias MavCodec.Definition.Document.Enumeration

  @doc "The enums of all sources, in rank order, with those of one name as one, and their modules."
  @spec merge([Enumeration.t()]) :: [{module(), Enumeration.t()}]
  def merge(enums) do
    enums
    |> Enum.group_by(& &1.name)
    |> Enum.sort()
    |> Enum.map(fn {name, pieces} ->
      entries = pieces |> Enum.flat_map(& &1.entries) |> Enum.reduce(%{}, &add_entry(&1, &2, name))
      # If a value has two names, that of the higher-ranking source comes first.
      entries = entries |> Map.values() |> Enum.sort_by(fn {index, entry} -> {entry.value, index} end)

      {Naming.enum(name),
       %{hd(pieces) | bitmask: Enum.any?(pieces, & &1.bitmask), entries: Enum.map(entries, &elem(&1, 1))}}
    end)
  end

  defp add_entry(entry, entries, enum) do
    case Map.fetch(entries, entry.name) do
      :error ->
        Map.put(entries, entry.name, {map_size(entries), entry})

      {:ok, {_index, %{value: value}}} when value == entry.value ->
        entries

      {:ok, {_index, first}} ->
        raise Error,
          file: entry.file,
          line: entry.line,
          reason:
            "#{entry.name} of enum #{enum} is #{entry.value}, but #{first.value} in #{first.file} of another source"
    end
  end
end
