defmodule Aerie.Console.Pages.Fleet.Board do
  @moduledoc """
  The rows of all vehicles with their lines of the table, for all pages of the fleet. Pure;
  `Aerie.Console.Pages.Fleet.Board.Server` keeps it.

  A row that looks as before is kept with its line, so that it is rendered once however many pages show it, and a page
  hears only which rows have changed since it last asked. What the map draws of a vehicle is also encoded once.
  """

  alias Aerie.Console.Map.Payload
  alias Aerie.Console.Pages.Fleet.Board.Row

  @enforce_keys [:id]
  defstruct [
    :id,
    version: 0,
    ids: [],
    rows: %{},
    choices: %{tags: [], kinds: [], autopilots: []},
    homes: [],
    missions: %{},
    # The versions with the last change.
    listed: 0,
    urgent: 0,
    placed: 0,
    # What left the map last, and the versions before and after.
    left: {0, 0, []}
  ]

  @type t :: %__MODULE__{}

  @typedoc "What a page has seen of which board, `nil` for nothing: the rows, those that are urgent, and the rest."
  @type seen ::
          {reference(), rows :: non_neg_integer(), urgent :: non_neg_integer(), rest :: non_neg_integer()}
          | nil

  @typedoc """
  `:rows` are those that a page has not seen yet; `:ids` are all, in their order; `:choices` are the tags, kinds and
  autopilots of all vehicles.
  `:places` has the homes and the missions by vehicle, `nil` if they are as the page saw them.
  """
  @type news :: %{
          seen: seen(),
          ids: [String.t()],
          rows: [Row.t()],
          choices: %{tags: [String.t()], kinds: [String.t()], autopilots: [atom()]},
          places: %{homes: [[float()]], missions: %{String.t() => map()}} | nil
        }

  @doc "A board without vehicles."
  @spec new() :: t()
  def new, do: %__MODULE__{id: make_ref()}

  @doc "Takes the rows of all vehicles, and all tags. `render` makes the line of one."
  @spec put(t(), [Row.t()], [String.t()], (Row.t() -> term())) :: t()
  def put(%__MODULE__{version: version, rows: known} = board, rows, tags, render) do
    version = version + 1
    ids = Enum.map(rows, & &1.id)

    [kinds, autopilots] =
      for field <- [:kind, :autopilot], do: rows |> Enum.map(&Map.fetch!(&1, field)) |> Enum.uniq()

    homes = Payload.homes(Enum.map(rows, & &1.home))
    missions = Map.new(rows, &{&1.id, &1.mission})
    rows = Map.new(rows, &{&1.id, keep(known[&1.id], &1, version, render)})
    urgent? = Enum.any?(rows, fn {_id, {changed, _row}} -> changed.urgent == version end)
    placed? = {homes, missions} != {board.homes, board.missions}
    gone = for {id, {%{drawn: drawn}, _row}} when drawn != nil <- known, not drawn?(rows[id]), do: id

    %{
      board
      | version: version,
        ids: ids,
        rows: rows,
        choices: %{tags: tags, kinds: Enum.sort(kinds), autopilots: Enum.sort(autopilots)},
        homes: homes,
        missions: missions,
        listed: if(ids != board.ids, do: version, else: board.listed),
        urgent: if(urgent?, do: version, else: board.urgent),
        placed: if(placed?, do: version, else: board.placed),
        left: if(gone != [], do: {elem(board.left, 1), version, Enum.sort(gone)}, else: board.left)
    }
  end

  defp drawn?({%{drawn: drawn}, _row}), do: drawn != nil
  defp drawn?(nil), do: false

  # When the row, what is urgent of it, and its place on the map have changed; and what the map draws, encoded.
  defp keep(known, %Row{on_map: on_map} = row, version, render) do
    {changed, before} = known || {%{row: 0, urgent: 0, moved: 0, on_map: nil, drawn: nil}, nil}

    changed =
      if changed.on_map == on_map,
        do: changed,
        else: %{changed | moved: version, on_map: on_map, drawn: on_map && JSON.encode!(on_map)}

    # What `places` and the map have needs no row.
    row = %{row | on_map: nil, home: nil, mission: nil}

    cond do
      before != nil and %{row | line: before.line} == before ->
        {changed, before}

      before != nil and urgent(before) == urgent(row) ->
        {%{changed | row: version}, %{row | line: render.(row)}}

      true ->
        {%{changed | row: version, urgent: version}, %{row | line: render.(row)}}
    end
  end

  # What a page shows at once.
  defp urgent(row), do: {row.state, row.mode, row.problems, row.readiness, row.holder}

  @doc "What a page has not seen yet: of all rows, or of those with something `:urgent` unless vehicles came or went."
  @spec news(t(), seen(), :all | :urgent) :: news()
  def news(%__MODULE__{id: id, version: version} = board, seen, which \\ :all) do
    {rows, urgent, rest} = since(board, seen)

    {new, rows} =
      cond do
        which == :all or board.listed > urgent -> {changed(board, :row, rows), version}
        board.urgent > urgent -> {changed(board, :urgent, urgent), rows}
        true -> {[], rows}
      end

    places = if rest == 0 or board.placed > rest, do: Map.take(board, [:homes, :missions])
    %{seen: {id, rows, version, version}, ids: board.ids, rows: new, choices: board.choices, places: places}
  end

  defp changed(board, what, since),
    do: for({_id, {%{^what => at}, row}} when at > since <- board.rows, do: row)

  @doc "The version that a page has on its map, on which `drawn/2` depends: 0 for that of another board, nil for none."
  @spec on_map(t(), seen()) :: non_neg_integer() | nil
  def on_map(_board, nil), do: nil
  def on_map(board, seen), do: board |> since(seen) |> elem(2)

  @doc "The payload of `map:vehicles` without `map` for a page that has seen something; nil if nothing has changed."
  @spec drawn(t(), seen()) :: map() | nil
  def drawn(%__MODULE__{left: {before, left, gone}} = board, seen) do
    {_rows, _urgent, rest} = since(board, seen)
    all? = rest == 0 or rest < before
    since = if all?, do: 0, else: rest

    rows =
      for {_id, {%{moved: at, drawn: <<_::binary>> = text}, _row}} when at > since <- board.rows, do: text

    gone = if rest < left and not all?, do: gone, else: []

    if rows != [] or gone != [] or (all? and seen != nil),
      do: %{all: all?, vehicles: Payload.encoded(rows), gone: gone}
  end

  defp since(%{id: id}, {id, rows, urgent, rest}), do: {rows, urgent, rest}
  defp since(_board, _of_another_or_none), do: {0, 0, 0}
end
