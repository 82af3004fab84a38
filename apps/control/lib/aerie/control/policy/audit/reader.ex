defmodule Aerie.Control.Policy.Audit.Reader do
  @moduledoc """
  Pages of an audit log for people, newest first. It reads the files and asks no process; each record's own hash is checked, the chain as
  a whole is `Aerie.Control.Policy.Audit.Verify`'s.
  """

  alias Aerie.Control.Policy.Audit.Chain

  # Records searched for one page; then the page is returned as it is, with `more?` set.
  @max_searched 20_000

  @typedoc """
  - `before`: only records with a smaller number; nil: from the newest
  - `limit`: at most so many records
  - `type`: of the record (`"decision"` …); `decision`: `"allow"` or `"deny"`; nil: any
  - `text`: appears in one of the record's values, case ignored
  """
  @type query :: %{
          optional(:before) => pos_integer() | nil,
          optional(:limit) => 1..1000,
          optional(:type) => String.t() | nil,
          optional(:decision) => String.t() | nil,
          optional(:text) => String.t() | nil
        }

  @typedoc "`next`: the `before` of the page after this one; nil at the beginning of the log."
  @type page :: %{
          records: [%{String.t() => term()}],
          next: pos_integer() | nil,
          searched: non_neg_integer()
        }

  @doc "A page of the log in a folder."
  @spec page(Path.t(), query()) :: {:ok, page()} | {:error, String.t()}
  def page(dir, query) do
    case Chain.files(dir) do
      {:ok, %{segments: segments}} ->
        before = query[:before]
        segments = segments |> Enum.reverse() |> Enum.filter(&(before == nil or &1.first < before))
        {:ok, read(segments, Map.put_new(query, :limit, 100), %{records: [], next: nil, searched: 0})}

      {:error, reason} ->
        {:error, "#{dir}: #{:file.format_error(reason)}"}
    end
  end

  defp read([], _query, page), do: %{page | records: Enum.reverse(page.records), next: nil}

  defp read([segment | older], query, page) do
    page = segment |> records(query[:before]) |> Enum.reduce_while(page, &take(&1, &2, query))

    if page.next,
      do: %{page | records: Enum.reverse(page.records)},
      else: read(older, query, page)
  end

  # The newest first. A segment is an eighth of policy.audit.max_mb at most.
  defp records(segment, before) do
    case Chain.read(segment, {nil, nil}, [], &[&1 | &2]) do
      {:ok, _segment, _last, _ending, records} ->
        if before, do: Enum.drop_while(records, &(&1.n >= before)), else: records

      {:error, _gone} ->
        []
    end
  end

  defp take(%{n: n, fields: fields}, page, query) do
    cond do
      length(page.records) >= query.limit or page.searched >= @max_searched ->
        {:halt, %{page | next: n + 1}}

      matches?(fields, query) ->
        {:cont, %{page | records: [fields | page.records], searched: page.searched + 1}}

      true ->
        {:cont, %{page | searched: page.searched + 1}}
    end
  end

  defp matches?(fields, query) do
    same?(fields["type"], query[:type]) and same?(fields["decision"], query[:decision]) and
      contains?(fields, query[:text])
  end

  defp same?(_value, none) when none in [nil, ""], do: true
  defp same?(value, wanted), do: value == wanted

  defp contains?(_fields, none) when none in [nil, ""], do: true

  defp contains?(fields, text) do
    text = String.downcase(text)

    Enum.any?(fields, fn {key, value} ->
      key not in ["hash", "prev"] and value |> format() |> String.downcase() |> String.contains?(text)
    end)
  end

  @doc "A value of a record as text."
  @spec format(term()) :: String.t()
  def format(text) when is_binary(text), do: text
  def format(other), do: JSON.encode!(other)

  @doc "The files of a log, oldest first, for an export: one record a line."
  @spec files(Path.t()) :: [{Path.t(), non_neg_integer()}]
  def files(dir) do
    with {:ok, %{segments: segments}} <- Chain.files(dir),
         do: for(segment <- segments, do: {segment.path, segment.bytes}),
         else: ({:error, _reason} -> [])
  end
end
