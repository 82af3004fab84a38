defmodule Aerie.Fleet.Shadow.Document do
  @moduledoc """
  The desired state of a vehicle: fields, each with version, time, actor, reason and expiry, and a history of changes
  (Z1, Z3). A value; `Aerie.Fleet.Shadow.Documents` keeps it.

  A document is never removed: without fields it keeps its version, so that no older document is taken for a newer one
  (Z5).
  """

  alias Aerie.Base.Json
  alias Aerie.Fleet.Shadow.Update
  alias Aerie.Fleet.Shadow.Document.Field

  defstruct vehicle: nil, version: 0, updated_at: nil, fields: %{}, history: []

  @typedoc """
    * `:version` - the document's version when the field was last set
    * `:at`, `:expires_at` - unix microseconds; a field without expiry has nil
    * `:actor`, `:via` - who set it, and by which interface
  """
  @type entry :: %{
          value: term(),
          version: pos_integer(),
          at: integer(),
          actor: String.t(),
          via: String.t(),
          reason: String.t() | nil,
          expires_at: integer() | nil
        }
  @typedoc "`set` and `removed` are paths."
  @type change :: %{
          version: pos_integer(),
          at: integer(),
          actor: String.t(),
          via: String.t(),
          reason: String.t() | nil,
          set: [Field.path()],
          removed: [Field.path()]
        }
  @type t :: %__MODULE__{
          vehicle: String.t(),
          version: non_neg_integer(),
          updated_at: integer() | nil,
          fields: %{Field.path() => entry()},
          history: [change()]
        }
  @type author :: %{actor: String.t(), via: String.t()}

  @max_bytes 61_440
  @max_history 20
  @max_paths 32

  @doc "The largest document in bytes as JSON."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc "The empty document of a vehicle."
  @spec new(String.t()) :: t()
  def new(vehicle), do: %__MODULE__{vehicle: vehicle}

  @doc """
  The document after an update at `now`; its version is incremented even if nothing differs. `{:conflict, text}` if the
  update is based on another version, `{:limit, text}` if the document would be too large.
  """
  @spec apply(t(), Update.t(), author(), now :: integer()) ::
          {:ok, t()} | {:error, {:conflict | :limit, String.t()}}
  def apply(document, update, author, now) do
    if update.version in [nil, document.version],
      do: document |> change(update, author, now) |> bounded(),
      else:
        {:error,
         {:conflict,
          "the update is for version #{update.version}, and the document has version #{document.version}"}}
  end

  defp change(document, update, author, now) do
    version = document.version + 1
    kept = live(document, now)
    removals = for {path, nil} <- update.changes, do: path

    removed =
      for path <- Map.keys(document.fields),
          not is_map_key(kept, path) or Enum.any?(removals, &covers?(&1, path)),
          do: path

    by = Map.merge(author, %{version: version, at: now, reason: update.reason})

    set =
      for {path, value} <- update.changes, value != nil, into: %{} do
        {path, Map.merge(by, %{value: value, expires_at: update.expires_at})}
      end

    entry = Map.merge(by, %{set: paths(Map.keys(set)), removed: paths(removed)})

    %{
      document
      | version: version,
        updated_at: now,
        fields: document.fields |> Map.drop(removed) |> Map.merge(set),
        history: Enum.take([entry | document.history], @max_history)
    }
  end

  defp covers?(path, path), do: true

  defp covers?(name, path),
    do: String.ends_with?(name, "*") and String.starts_with?(path, String.trim_trailing(name, "*"))

  @doc "The changes that a document keeps of these, the newest first."
  @spec history([change()]) :: [change()]
  def history(changes),
    do: changes |> Enum.uniq() |> Enum.sort_by(&{-&1.version, -&1.at}) |> Enum.take(@max_history)

  # The values of a large change are in the history of the bucket.
  defp paths(paths) do
    case Enum.split(Enum.sort(paths), @max_paths) do
      {all, []} -> all
      {some, more} -> some ++ ["and #{length(more)} more"]
    end
  end

  @doc "The document, unless it is larger than a bucket takes."
  @spec bounded(t()) :: {:ok, t()} | {:error, {:limit, String.t()}}
  def bounded(document) do
    counts = document.fields |> Map.keys() |> Enum.frequencies_by(&hd(String.split(&1, ".")))
    full = Enum.find(Field.max_of_group(), fn {group, max} -> Map.get(counts, group, 0) > max end)

    cond do
      full != nil ->
        {group, max} = full
        {:error, {:limit, "#{group} would have #{counts[group]} entries; at most #{max} are kept"}}

      byte_size(JSON.encode!(plain(document))) > @max_bytes ->
        {:error, {:limit, "the document would be larger than #{@max_bytes} bytes"}}

      true ->
        {:ok, document}
    end
  end

  @doc "The fields that are in force at `now`."
  @spec live(t(), now :: integer()) :: %{Field.path() => entry()}
  def live(document, now),
    do:
      Map.filter(document.fields, fn {_path, entry} -> entry.expires_at == nil or now < entry.expires_at end)

  @doc "The document as plain values for JSON."
  @spec plain(t()) :: map()
  def plain(document) do
    %{
      "vehicle" => document.vehicle,
      "version" => document.version,
      "updated_at" => Json.time(document.updated_at),
      "fields" => Map.new(document.fields, fn {path, entry} -> {path, plain_entry(entry)} end),
      "history" => for(change <- document.history, do: plain_change(change))
    }
  end

  defp plain_entry(entry),
    do: entry |> common() |> Map.merge(%{"value" => entry.value, "expires_at" => Json.time(entry.expires_at)})

  defp plain_change(change),
    do: change |> common() |> Map.merge(%{"set" => change.set, "removed" => change.removed})

  defp common(entry) do
    %{
      "version" => entry.version,
      "at" => Json.time(entry.at),
      "actor" => entry.actor,
      "via" => entry.via,
      "reason" => entry.reason
    }
  end

  @doc "Reads what `plain/1` wrote. Every value is checked again, because others may write to the bucket."
  @spec parse(term(), vehicle :: String.t()) :: {:ok, t()} | {:error, String.t()}
  def parse(%{"vehicle" => vehicle, "version" => version, "fields" => fields} = object, vehicle)
      when is_integer(version) and version >= 0 and is_map(fields) do
    with {:ok, at} <- time(object["updated_at"]),
         {:ok, fields} <- all(fields, &entry/1),
         {:ok, history} <- all(Enum.take(List.wrap(object["history"]), @max_history), &change/1) do
      {:ok,
       %__MODULE__{
         vehicle: vehicle,
         version: version,
         updated_at: at,
         fields: Map.new(fields),
         history: history
       }}
    end
  end

  def parse(_other, _vehicle), do: {:error, "it is not a document of this vehicle"}

  defp entry({path, %{"value" => value} = entry}) do
    with {:ok, field} <- Field.fetch(path),
         {:ok, value} <- Field.check(field, path, value),
         {:ok, common} <- read(entry),
         {:ok, expires} <- time(entry["expires_at"]) do
      {:ok, {path, Map.merge(common, %{value: value, expires_at: expires})}}
    end
  end

  defp entry(_other), do: :error

  defp change(%{"set" => set, "removed" => removed} = change) do
    with {:ok, common} <- read(change),
         true <- Enum.all?(List.wrap(set) ++ List.wrap(removed), &is_binary/1),
         do: {:ok, Map.merge(common, %{set: List.wrap(set), removed: List.wrap(removed)})}
  end

  defp change(_other), do: :error

  defp read(%{"version" => version, "actor" => actor, "via" => via} = object)
       when is_integer(version) and version > 0 and is_binary(actor) and is_binary(via) do
    with {:ok, at} when at != nil <- time(object["at"]),
         reason when is_nil(reason) or is_binary(reason) <- object["reason"],
         do: {:ok, %{version: version, at: at, actor: actor, via: via, reason: reason}}
  end

  defp read(_other), do: :error

  defp time(nil), do: {:ok, nil}

  defp time(text) when is_binary(text) do
    with {:ok, time, _offset} <- DateTime.from_iso8601(text), do: {:ok, DateTime.to_unix(time, :microsecond)}
  end

  defp time(_other), do: :error

  defp all(items, read) do
    Enum.reduce_while(items, {:ok, []}, fn item, {:ok, done} ->
      case read.(item) do
        {:ok, value} -> {:cont, {:ok, [value | done]}}
        _wrong -> {:halt, {:error, "a gateway does not write one of its fields"}}
      end
    end)
    |> case do
      {:ok, done} -> {:ok, Enum.reverse(done)}
      error -> error
    end
  end
end
