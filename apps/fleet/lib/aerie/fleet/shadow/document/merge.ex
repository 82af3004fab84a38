defmodule Aerie.Fleet.Shadow.Document.Merge do
  @moduledoc """
  Brings a vehicle's desired document aboard and that of the hub to one, after a cut in which both may have changed. Pure.

  Both are compared with the last document that they had in common, field by field:

  | the field was changed | what counts |
  |---|---|
  | on one side | that change; a removal too |
  | on both sides | the hub's |

  No clock decides, because one of a vehicle without a network is often wrong. The result is newer than both, unless one side did not
  change: then it is the other side's document as it is. A document that is older than the common one was put back by somebody, and
  counts as unchanged (Z5).

  What the hub may not change aboard is taken back from it first (`permitted/4`), and the result tells so.
  """

  alias Aerie.Fleet.Shadow.Document
  alias Aerie.Fleet.Shadow.Document.Field

  @both "changed aboard and at the hub: the hub's counts for the fields below"
  @refused "refused aboard: the hub may not change these there (policy.sources of the gateway aboard)"

  @doc """
  The hub's document with the fields aboard in place of those that it may not set or remove, and these fields. What is aboard already is not a
  change. `allowed?` gets a path and a value, nil for a field that is removed.
  """
  @spec permitted(Document.t(), aboard :: Document.t(), hub :: Document.t(), (Field.path(), term() ->
                                                                                boolean())) ::
          {Document.t(), [Field.path()]}
  def permitted(base, aboard, hub, allowed?) do
    refused =
      for path <- Enum.uniq(Map.keys(base.fields) ++ Map.keys(hub.fields)),
          entry <- [hub.fields[path]],
          entry != base.fields[path] and entry != aboard.fields[path],
          not allowed?.(path, entry && entry.value),
          do: path

    fields = hub.fields |> Map.drop(refused) |> Map.merge(Map.take(aboard.fields, refused))
    {%{hub | fields: fields}, Enum.sort(refused)}
  end

  @doc """
  The document that both sides shall have. `base`: the last one that they had in common, of version 0 if that is not known; `refused`: what
  `permitted/4` took from the hub's.
  """
  @spec merge(Document.t(), aboard :: Document.t(), hub :: Document.t(), now :: integer(), [Field.path()]) ::
          Document.t()
  def merge(base, aboard, hub, now, refused \\ [])

  # Newer than the hub's, so that the hub learns of it.
  def merge(base, aboard, hub, now, [_ | _] = refused) do
    merged = join(base, aboard, hub, now)
    told = %{merged(merged.version, [], @refused, now) | removed: refused}
    # The merge itself has an entry only where something was changed on both sides.
    history = Enum.reject(merged.history, &(&1.version == merged.version and &1.reason != @both))
    %{merged | history: Document.history([told | history])}
  end

  def merge(base, aboard, hub, now, []) do
    cond do
      same?(aboard, hub) -> aboard
      # Nothing was changed, or the same on both sides.
      aboard.fields == hub.fields and max(aboard.version, hub.version) >= base.version -> newer(aboard, hub)
      unchanged?(hub, base) and aboard.version > hub.version -> aboard
      unchanged?(aboard, base) and hub.version > aboard.version -> hub
      true -> join(base, aboard, hub, now)
    end
  end

  @doc "Whether two documents desire the same, set by the same."
  @spec same?(Document.t(), Document.t()) :: boolean()
  def same?(one, other), do: one.version == other.version and one.fields == other.fields

  defp newer(aboard, hub), do: if(aboard.version > hub.version, do: aboard, else: hub)

  defp unchanged?(document, base), do: document.version < base.version or same?(document, base)

  defp join(base, aboard, hub, now) do
    hub_fields = if hub.version < base.version, do: base.fields, else: hub.fields
    aboard_fields = if aboard.version < base.version, do: base.fields, else: aboard.fields
    paths = Enum.uniq(Map.keys(aboard_fields) ++ Map.keys(hub_fields))

    fields =
      for path <- paths,
          entry = chosen(base.fields[path], aboard_fields[path], hub_fields[path]),
          into: %{},
          do: {path, entry}

    version = max(aboard.version, hub.version) + 1
    changed? = fn one, other -> Enum.any?(paths, &(one[&1] not in [base.fields[&1], other[&1]])) end
    overruled = for path <- paths, overruled?(path, base, aboard_fields, hub_fields), do: path
    why = why(changed?.(aboard_fields, hub_fields), changed?.(hub_fields, aboard_fields), overruled)

    document = %Document{
      vehicle: aboard.vehicle,
      version: version,
      updated_at: now,
      fields: fields,
      history: Document.history([merged(version, overruled, why, now) | aboard.history ++ hub.history])
    }

    # Together they may be more than a document holds.
    case Document.bounded(document) do
      {:ok, document} -> document
      {:error, _limit} -> %{document | fields: hub_fields}
    end
  end

  # Unchanged at the hub: what is aboard, changed or not.
  defp chosen(base, aboard, base), do: aboard
  defp chosen(_base, _aboard, hub), do: hub

  defp overruled?(path, base, aboard, hub),
    do: hub[path] != base.fields[path] and aboard[path] != base.fields[path] and aboard[path] != hub[path]

  defp why(_aboard, _hub, [_ | _]), do: @both
  defp why(true, true, []), do: "changed aboard and at the hub, in different fields"
  defp why(true, false, []), do: "changed aboard"
  defp why(false, true, []), do: "changed at the hub"
  defp why(false, false, []), do: "brought to one version: no field was changed"

  defp merged(version, overruled, reason, now) do
    %{
      version: version,
      at: now,
      actor: "shadow",
      via: "leaf",
      reason: reason,
      set: overruled,
      removed: []
    }
  end
end
