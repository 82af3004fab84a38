defmodule Phoenix.LiveView.LiveStream do
  @moduledoc """
  Rows that the client keeps: the server sends only inserts and deletions (`Phoenix.LiveView.stream/4`).

  A template enumerates it as `{dom_id, item}`: the inserts of this rendering, in order.
  """

  @enforce_keys [:name, :dom_id, :ref]
  defstruct [:name, :dom_id, :ref, inserts: [], deletes: [], reset?: false]

  @type t :: %__MODULE__{
          name: atom(),
          dom_id: (term() -> String.t()),
          ref: String.t(),
          inserts: [{String.t(), integer(), term(), integer() | nil, boolean() | nil}],
          deletes: [String.t()],
          reset?: boolean()
        }

  @doc "An empty stream. Options: `:dom_id`, a function of an item; by default `\#{name}-\#{item.id}`."
  @spec new(atom(), String.t(), keyword()) :: t()
  def new(name, ref, options \\ []) do
    dom_id = Keyword.get(options, :dom_id, &"#{name}-#{id!(&1)}")
    %__MODULE__{name: name, ref: ref, dom_id: dom_id}
  end

  defp id!(%{id: id}), do: id

  defp id!(other),
    do:
      raise(
        ArgumentError,
        "expected an item of a stream to have an :id, or give dom_id:, got: #{inspect(other)}"
      )

  @doc "Inserts an item or moves it. Options: `:at` (-1: at the end), `:limit`, `:update_only`."
  @spec insert(t(), term(), keyword()) :: t()
  def insert(%__MODULE__{} = stream, item, options) do
    id = stream.dom_id.(item)
    insert = {id, Keyword.get(options, :at, -1), item, options[:limit], options[:update_only]}
    # Only the last insert of a row counts.
    %{
      stream
      | inserts: [insert | List.keydelete(stream.inserts, id, 0)],
        deletes: List.delete(stream.deletes, id)
    }
  end

  @doc "Deletes the row with this DOM id."
  @spec delete(t(), String.t()) :: t()
  def delete(%__MODULE__{} = stream, id),
    do: %{
      stream
      | deletes: [id | List.delete(stream.deletes, id)],
        inserts: List.keydelete(stream.inserts, id, 0)
    }

  @doc "Empties the stream in the client."
  @spec reset(t()) :: t()
  def reset(%__MODULE__{} = stream), do: %{stream | reset?: true, inserts: [], deletes: []}

  @doc "Clears the changes after a rendering was sent."
  @spec prune(t()) :: t()
  def prune(%__MODULE__{} = stream), do: %{stream | inserts: [], deletes: [], reset?: false}

  @doc "The number of unsent changes."
  @spec size(t()) :: non_neg_integer()
  def size(%__MODULE__{inserts: inserts, deletes: deletes}), do: length(inserts) + length(deletes)

  @doc false
  @spec wire(t()) :: list()
  def wire(%__MODULE__{} = stream) do
    inserts = for {id, at, _item, limit, only} <- Enum.reverse(stream.inserts), do: [id, at, limit, only]
    base = [stream.ref, inserts, stream.deletes]
    if stream.reset?, do: base ++ [true], else: base
  end

  defimpl Enumerable do
    def count(stream), do: {:ok, length(stream.inserts)}
    def member?(_stream, _item), do: {:error, __MODULE__}
    def slice(_stream), do: {:error, __MODULE__}

    def reduce(stream, accumulator, fun) do
      stream.inserts
      |> Enum.reverse()
      |> Enum.map(fn {id, _at, item, _limit, _only} -> {id, item} end)
      |> Enumerable.List.reduce(accumulator, fun)
    end
  end
end
