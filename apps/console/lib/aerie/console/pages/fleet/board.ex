defmodule Aerie.Console.Pages.Fleet.Board do
  @moduledoc """
  The rows of all vehicles with their rendered cells, for all pages of the fleet. Pure;
  `Aerie.Console.Pages.Fleet.Board.Server` keeps it.

  A row that looks as before is kept with its cells, so that it is rendered once however many pages show it, and a page
  hears only which rows have changed since it last asked.
  """

  alias Aerie.Console.Pages.Fleet.Board.Row

  @enforce_keys [:id]
  defstruct [:id, version: 0, ids: [], rows: %{}, words: []]

  @type t :: %__MODULE__{
          id: reference(),
          version: non_neg_integer(),
          ids: [String.t()],
          rows: %{String.t() => {changed :: pos_integer(), Row.t()}},
          words: [String.t()]
        }

  @typedoc "What a page has seen of which board, `nil` for nothing."
  @type seen :: {reference(), version :: non_neg_integer()} | nil

  @typedoc """
  `:rows` are those that a page has not seen yet; `:ids` are all, in their order; `:words` are the tags of all vehicles.
  """
  @type news :: %{seen: seen(), ids: [String.t()], rows: [Row.t()], words: [String.t()]}

  @doc "A board without vehicles."
  @spec new() :: t()
  def new, do: %__MODULE__{id: make_ref()}

  @doc "Takes the rows of all vehicles. `render` makes the cells of one."
  @spec put(t(), [Row.t()], [String.t()], (Row.t() -> term())) :: t()
  def put(%__MODULE__{version: version, rows: known} = board, rows, words, render) do
    version = version + 1

    rows = for row <- rows, do: {row.id, keep(known[row.id], row, version, render)}
    %{board | version: version, ids: Enum.map(rows, &elem(&1, 0)), rows: Map.new(rows), words: words}
  end

  defp keep({_changed, before} = kept, row, version, render) do
    cond do
      %{before | cells: nil} == row -> kept
      in_cells(before) == in_cells(row) -> {version, %{row | cells: before.cells}}
      true -> keep(nil, row, version, render)
    end
  end

  defp keep(nil, row, version, render), do: {version, %{row | cells: render.(row)}}

  # The map alone shows where a vehicle is.
  defp in_cells(row), do: %{row | on_map: nil, home: nil, mission: nil, cells: nil}

  @doc "What a page has not seen yet."
  @spec news(t(), seen()) :: news()
  def news(%__MODULE__{id: id, version: version} = board, seen) do
    since = with {^id, since} <- seen, do: since, else: (_of_another_or_none -> 0)
    rows = for {_id, {changed, row}} <- board.rows, changed > since, do: row
    %{seen: {id, version}, ids: board.ids, rows: rows, words: board.words}
  end
end
