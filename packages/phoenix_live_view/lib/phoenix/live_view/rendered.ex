defmodule Phoenix.LiveView.Rendered do
  @moduledoc """
  A rendered template: `static` pieces of markup with a `dynamic` node between each two.

  A node is text that is already escaped, another `Rendered`, or a `Phoenix.LiveView.Comprehension`. All of them are plain
  values: comparing them shows what changed between two renderings (`Phoenix.LiveView.Diff`). `root` says that the
  template is one element, which lets the client skip it if nothing in it changed.
  """

  defstruct static: [""], dynamic: [], root: false

  @type tree :: String.t() | t() | Phoenix.LiveView.Comprehension.t()
  @type t :: %__MODULE__{static: [String.t()], dynamic: [tree()], root: boolean()}
end

defmodule Phoenix.LiveView.Comprehension do
  @moduledoc """
  The rows of a `:for`: one `static` for all, and for each row its key and its dynamic nodes.
  """

  alias Phoenix.LiveView.Rendered

  defstruct static: [""], entries: []

  @type entry :: {key :: term(), [Rendered.tree()]}
  @type t :: %__MODULE__{static: [String.t()], entries: [entry()]}

  @doc """
  Rows with their keys; `:index` in place of a key means the row's position. Raises `ArgumentError` when two rows have the
  same key: the client could not tell them apart.
  """
  @spec new([String.t()], [{term() | :index, [Rendered.tree()]}]) :: t()
  def new(static, [{:index, _} | _] = entries) do
    entries = entries |> Enum.with_index() |> Enum.map(fn {{:index, dynamic}, index} -> {index, dynamic} end)
    %__MODULE__{static: static, entries: entries}
  end

  def new(static, entries) do
    _ =
      Enum.reduce(entries, %{}, fn {key, _dynamic}, seen ->
        if is_map_key(seen, key),
          do: raise(ArgumentError, "two rows of a :for have the same :key #{inspect(key)}"),
          else: Map.put(seen, key, true)
      end)

    %__MODULE__{static: static, entries: entries}
  end
end

defimpl Phoenix.HTML.Safe, for: [Phoenix.LiveView.Rendered, Phoenix.LiveView.Comprehension] do
  defdelegate to_iodata(tree), to: Phoenix.LiveView.Diff
end
