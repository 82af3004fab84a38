defmodule Aerie.Fleet.Shadow.Document.Tags do
  @moduledoc """
  The tags of all vehicles: words by which people and programs find them and form groups. They are the desired field `tags`, and
  nothing else keeps them. `Aerie.Fleet.Shadow.Documents.Server` notes them beside the documents, so that reading them costs little.
  """

  alias Aerie.Fleet.Shadow.Document

  # A bucket that somebody filled costs no more memory than this.
  @max_rows 8_192

  @type tags :: %{(vehicle :: String.t()) => [String.t(), ...]}

  @doc "Notes a document's tags in the table; true if they are others than before."
  @spec note(:ets.table(), Document.t()) :: boolean()
  def note(table, %Document{vehicle: vehicle, fields: fields}) do
    case {fields["tags"], :ets.lookup(table, {:tags, vehicle})} do
      {%{value: [_ | _] = words, expires_at: until}, [{_key, words, until}]} -> false
      {%{value: [_ | _] = words, expires_at: until}, before} -> insert(table, vehicle, words, until, before)
      {_none, before} -> delete(table, vehicle, before)
    end
  end

  defp insert(table, vehicle, words, until, before) do
    if before != [] or :ets.info(table, :size) < @max_rows,
      do: :ets.insert(table, {{:tags, vehicle}, words, until}),
      else: false
  end

  defp delete(_table, _vehicle, []), do: false
  defp delete(table, vehicle, _before), do: :ets.delete(table, {:tags, vehicle})

  @doc "The tags in a table at `now` (unix microseconds)."
  @spec of(:ets.table(), now :: integer()) :: tags()
  def of(table, now) do
    for [vehicle, words, until] <- :ets.match(table, {{:tags, :"$1"}, :"$2", :"$3"}),
        until == nil or now < until,
        into: %{},
        do: {vehicle, words}
  end

  @doc "All words that are in use, in alphabetical order."
  @spec all(tags()) :: [String.t()]
  def all(tags), do: tags |> Map.values() |> Enum.concat() |> Enum.uniq() |> Enum.sort()

  @doc "Words as they are kept: trimmed, sorted, each once."
  @spec tidy([String.t()]) :: [String.t()]
  def tidy(words),
    do: words |> Enum.map(&String.trim/1) |> Enum.reject(&(&1 == "")) |> Enum.uniq() |> Enum.sort()
end
