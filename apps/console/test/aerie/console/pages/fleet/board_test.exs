defmodule Aerie.Console.Pages.Fleet.BoardTest do
  use Aerie.ConsoleCase, async: true

  alias Aerie.Base.{Names, Store}
  alias Aerie.Console.Pages.Fleet.{Board, Table}
  alias Aerie.Console.Pages.Fleet.Board.Row

  defp row(id, fields \\ []) do
    fields = Keyword.merge([id: id, network: "main", system_id: 1, kind: "copter", autopilot: :px4], fields)
    struct!(Row, Keyword.merge([status: :online, state: :armed], fields))
  end

  # Each rendering is told to the test.
  defp put(board, rows) do
    Board.put(board, rows, [], fn row ->
      send(self(), {:rendered, row.id})
      {:line, row.speed}
    end)
  end

  defp rendered do
    receive do
      {:rendered, id} -> [id | rendered()]
    after
      0 -> []
    end
  end

  test "a row is rendered and told when what it shows has changed; the map hears of the rest" do
    board = put(Board.new(), [row("A", speed: 1.0, on_map: ["A", 1.0]), row("B")])
    assert rendered() == ["A", "B"]
    news = Board.news(board, nil)
    assert {news.ids, length(news.rows)} == {["A", "B"], 2}

    moved = put(board, [row("A", speed: 1.0, on_map: ["A", 2.0]), row("B")])
    assert rendered() == []
    assert Board.news(moved, news.seen).rows == []
    assert drawn(moved, news.seen) == %{"all" => false, "vehicles" => [["A", 2.0]], "gone" => []}

    faster = put(moved, [row("A", speed: 2.0, on_map: ["A", 2.0]), row("B")])
    assert rendered() == ["A"]
    assert [%{id: "A", line: {:line, 2.0}}] = Board.news(faster, Board.news(moved, nil).seen).rows
    assert Board.news(faster, Board.news(faster, nil).seen).rows == []
    assert Board.drawn(faster, Board.news(faster, nil).seen) == nil
  end

  test "a page hears what is urgent before the rest, and the rest afterwards" do
    board = put(Board.new(), [row("A", speed: 1.0), row("B", mode: "AUTO")])
    %{seen: seen} = Board.news(board, nil)
    board = put(board, [row("A", speed: 2.0), row("B", mode: "AUTO")])
    assert %{rows: [], seen: seen} = Board.news(board, seen, :urgent)
    board = put(board, [row("A", speed: 2.0), row("B", mode: "LAND")])
    assert %{rows: [%{id: "B"}], seen: seen} = Board.news(board, seen, :urgent)
    assert %{rows: [], seen: seen} = Board.news(board, seen, :urgent)
    assert %{rows: [%{id: "A"}, %{id: "B"}]} = news = Board.news(board, seen, :all)
    # However late a page hears of the rows, its map is as new as that of the others.
    assert Board.on_map(board, seen) == Board.on_map(board, news.seen)

    # Nobody can show ids without their rows.
    board = put(board, [row("A", speed: 3.0), row("B", mode: "LAND"), row("C")])
    assert Board.news(board, seen, :urgent).rows |> Enum.map(& &1.id) == ["A", "B", "C"]
  end

  test "a page hears of homes and missions when they have changed" do
    board = put(Board.new(), [row("A", home: [1.0, 2.0], mission: %{total: 3, current: 1})])

    assert %{places: %{homes: [[1.0, 2.0]], missions: %{"A" => %{total: 3, current: 1}}}, seen: seen} =
             Board.news(board, nil)

    assert Board.news(board, seen).places == nil
    assert %{places: %{homes: []}} = board |> put([row("A")]) |> Board.news(seen)
  end

  # As the browser reads it.
  defp drawn(board, seen), do: with(%{} = payload <- Board.drawn(board, seen), do: decoded(payload))
  defp decoded(payload), do: payload |> JSON.encode!() |> JSON.decode!()

  test "payloads of the map, applied as the map does, give what is drawn, however often a page asks" do
    place = :proper_types.oneof([nil, ["x", 1], ["x", 2]])
    rows = :proper_types.list({:proper_types.oneof(~w(A B C)), place})

    property =
      :proper.forall(
        :proper_types.list({rows, :proper_types.boolean(), :proper_types.range(1, 8)}),
        fn steps ->
          Enum.reduce_while(steps, {Board.new(), {nil, %{}}}, fn {rows, ask?, again},
                                                                 {board, {seen, fleet}} ->
            rows = Map.new(rows)
            board = if again == 1, do: Board.new(), else: board

            board =
              Board.put(
                board,
                for({id, place} <- rows, do: row(id, on_map: place && [id | place])),
                [],
                & &1.speed
              )

            expected = for {id, [_ | _] = place} <- rows, into: %{}, do: {id, [id | place]}
            fleet = if ask?, do: draw(fleet, drawn(board, seen)), else: fleet

            cond do
              not ask? -> {:cont, {board, {seen, fleet}}}
              fleet == expected -> {:cont, {board, {Board.news(board, seen).seen, fleet}}}
              true -> {:halt, {:differs, fleet, expected}}
            end
          end)
          |> then(&(not match?({:differs, _fleet, _expected}, &1)))
        end
      )

    assert :proper.quickcheck(property, [:quiet, {:numtests, 300}]) == true, inspect(:proper.counterexample())
  end

  # update() of assets/hooks/map/vehicles/vehicles.js
  defp draw(fleet, nil), do: fleet

  defp draw(fleet, %{"all" => all?, "vehicles" => rows, "gone" => gone}) do
    fleet = if all?, do: %{}, else: Map.drop(fleet, gone)
    Map.merge(fleet, Map.new(rows, &{hd(&1), &1}))
  end

  test "a page with another board gets all, and vehicles that are gone are not among the ids" do
    board = Board.new() |> put([row("A"), row("B")]) |> put([row("B")])

    assert %{ids: ["B"], rows: [%{id: "B"}]} =
             Board.news(board, Board.news(put(Board.new(), [row("A")]), nil).seen)

    assert %{ids: ["B"], rows: []} = Board.news(board, Board.news(board, nil).seen)
  end

  test "news, applied as a page does, give all rows" do
    rows = :proper_types.list({:proper_types.oneof(~w(A B C)), :proper_types.range(1, 3)})

    property =
      :proper.forall(:proper_types.list({rows, :proper_types.boolean()}), fn steps ->
        {board, {_seen, known}} =
          Enum.reduce(steps, {Board.new(), {nil, %{}}}, fn {rows, ask?}, {board, page} ->
            rows = for {id, speed} <- Map.new(rows), do: row(id, speed: speed)
            board = Board.put(board, rows, [], & &1.speed)
            {board, if(ask?, do: applied(page, board), else: page)}
          end)

        {_seen, known} = applied({nil, known}, board)
        known == Map.new(board.rows, fn {id, {_changed, row}} -> {id, row} end)
      end)

    assert :proper.quickcheck(property, [:quiet, {:numtests, 200}]) == true, inspect(:proper.counterexample())
  end

  defp applied({seen, known}, board) do
    news = Board.news(board, seen)
    {news.seen, known |> Map.merge(Map.new(news.rows, &{&1.id, &1})) |> Map.take(news.ids)}
  end

  test "a page goes on when the board is started again, and shows what is there then" do
    [console: console] = start_console()
    put_vehicle(console, "V1")
    {:ok, view, _html} = live(conn(console), "/")
    board = GenServer.whereis(Names.via(console.gateway, :console_board))
    monitor = Process.monitor(board)
    Process.exit(board, :kill)
    assert_receive {:DOWN, ^monitor, :process, ^board, :killed}
    :ok = Store.delete_vehicle(console.gateway, {"main", :erlang.phash2("V1", 200) + 1})
    put_vehicle(console, "V2")
    eventually(fn -> GenServer.whereis(Names.via(console.gateway, :console_board)) not in [nil, board] end)

    # The page dies with the board if it asks in this moment, and a browser joins again.
    view = if Process.alive?(view.pid), do: view, else: elem(live(conn(console), "/"), 1)
    html = refresh_fleet(view)
    assert html =~ "vehicle-V2"
    refute html =~ "vehicle-V1"
  end

  test "the line is that of the table", %{} do
    html = row("V1", mode: "AUTO", speed: 3.0) |> Table.line() |> Phoenix.LiveViewTest.rendered_to_string()
    assert html =~ "Mission <small>AUTO</small>"
    assert html =~ ~r/data-label="Speed" class="number">3.0</
  end
end
