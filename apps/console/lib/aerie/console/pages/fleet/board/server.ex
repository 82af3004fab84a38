defmodule Aerie.Console.Pages.Fleet.Board.Server do
  @moduledoc """
  Reads all vehicles and renders their rows once for all pages of the fleet: when a page asks, and not more often than ten times a second.
  While nobody asks, it does nothing.
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Policy
  alias Aerie.Fleet
  alias Aerie.Fleet.Shadow
  alias Aerie.Vehicle.Snapshot
  alias Aerie.Console.Pages.Fleet.{Board, Table}
  alias Aerie.Console.Pages.Fleet.Board.Row

  # Not more often than this; for pages that heard the same notice not again within the time of a notice, however
  # late they ask, because what is read between two notices would be old at the next one.
  @again_ms 100
  @fresh_ms 200
  @ready_ms 1_000

  @doc "Options: `:gateway`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :console_board))

  @doc """
  What the calling page has not seen yet (`Board.news/3`), and what its map has not (`:drawn`, `Board.drawn/2`). `:now` reads the vehicles again even if that was done just before, for a change that the
  page knows of. Exits if the server is gone, as a page without rows has nothing to show.
  """
  @spec news(Names.gateway(), Board.seen(), :now | :recent, :all | :urgent) :: map()
  def news(gateway, seen, age \\ :recent, which \\ :all),
    do: GenServer.call(Names.via(gateway, :console_board), {:news, seen, age, which}, :infinity)

  @impl GenServer
  def init(options) do
    Process.set_label({:console_board, options[:gateway]})
    {:ok, %{gateway: options[:gateway], board: Board.new(), read: nil, drawn: %{}, ready: {nil, %{}}}}
  end

  @impl GenServer
  def handle_call({:news, seen, age, which}, _from, state) do
    now = System.monotonic_time(:millisecond)
    on_map = Board.on_map(state.board, seen)
    enough = if on_map == state.board.version, do: @again_ms, else: @fresh_ms
    fresh? = age == :recent and state.read != nil and now - state.read < enough
    state = if fresh?, do: state, else: read(state, now, age)
    state = update_in(state.drawn, &Map.put_new_lazy(&1, on_map, fn -> Board.drawn(state.board, seen) end))
    {:reply, state.board |> Board.news(seen, which) |> Map.put(:drawn, state.drawn[on_map]), state}
  end

  defp read(%{gateway: gateway, board: board} = state, at, age) do
    now = System.os_time(:microsecond)
    links = Store.links(gateway)
    tags = Shadow.tags(gateway)
    leases = Policy.control_leases(gateway)
    vehicles = Fleet.vehicles(gateway)
    {_then, readiness} = ready = ready(state, vehicles, at, age)
    rows = for vehicle <- vehicles, do: Row.new(vehicle, links, tags, now, leases, readiness)
    board = Board.put(board, rows, Shadow.all_tags(tags), &Table.line/1)
    %{state | board: board, read: at, drawn: %{}, ready: ready}
  end

  # It costs more than a row, and nobody needs it more often.
  defp ready(%{gateway: gateway, ready: {then, known}}, vehicles, at, age) do
    if age == :recent and then != nil and at - then < @ready_ms do
      {then, known}
    else
      {at, Fleet.readinesses(gateway, Enum.reject(vehicles, &Snapshot.data(&1, :mode)[:armed]))}
    end
  end
end
