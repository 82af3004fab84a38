defmodule Aerie.Console.Pages.Fleet.Act.Live do
  @moduledoc """
  What the page of the fleet keeps of its acts: the sheet that is being prepared (`@sheet`), `@facts` of its vehicles,
  `@sheet_error`, and `@preview`, what the map shows of it. Each act is one operation of the gateway, so it goes on
  without the page, and the strip of all pages shows what becomes of it.
  """
  import Phoenix.Component, only: [assign: 2, assign: 3]
  import Phoenix.LiveView, only: [clear_flash: 1, push_event: 3, put_flash: 3]

  alias Aerie.Console.Pages.Fleet.Act.{Ask, Height, Mode, Press, Sheet, Sheets}
  alias Aerie.Fleet
  alias Aerie.Vehicle.Snapshot
  alias Phoenix.LiveView.Socket

  @doc "Without a sheet."
  @spec mount(Socket.t()) :: Socket.t()
  # The map may still show the sheet of a page that has died.
  def mount(socket),
    do: socket |> assign(sheet: nil, facts: %{}, sheet_error: nil, working: nil) |> push_preview([])

  @doc "After the vehicles have changed."
  @spec follow(Socket.t()) :: Socket.t()
  def follow(%{assigns: %{sheet: nil}} = socket), do: socket
  def follow(socket), do: look(socket)

  @doc "Begins what a press asks for, for these vehicles."
  @spec command(Socket.t(), event :: map(), [String.t()]) :: Socket.t()
  def command(socket, event, ids), do: pressed(socket, Press.request(event, ids))

  @doc "Begins another height for those of these rows that are in the air."
  @spec height(Socket.t(), event :: map(), [map()]) :: Socket.t()
  def height(%{assigns: %{gateway: gateway}} = socket, event, rows) do
    height =
      &with(%{} = vehicle <- Fleet.vehicle(gateway, &1), do: Snapshot.data(vehicle, :position)[:alt_rel])

    pressed(socket, Height.request(event, rows, height))
  end

  @doc "Sets the mode of these rows that was shown of them."
  @spec mode(Socket.t(), event :: map(), [map()]) :: Socket.t()
  def mode(socket, event, rows), do: pressed(socket, Mode.request(event, rows))

  defp pressed(socket, request) do
    with {:ok, request} <- request, {:ok, socket} <- begin(socket, request) do
      clear_flash(socket)
    else
      {:error, text} -> put_flash(socket, :error, "Nothing was sent: #{text}")
    end
  end

  defp begin(%{assigns: %{gateway: gateway, user: user}} = socket, request) do
    case Fleet.begin_operation(gateway, request, user, "console") do
      {:ok, _operation} ->
        # The strip shows it at once.
        send(self(), :console_operations)
        {:ok, socket}

      {:error, refusal} ->
        {:error, Fleet.refusal(refusal)}
    end
  end

  @doc "Opens a sheet for these vehicles."
  @spec open(Socket.t(), name :: String.t(), [String.t()]) :: Socket.t()
  def open(%{assigns: %{gateway: gateway}} = socket, name, ids) do
    vehicles = for id <- ids, vehicle = Fleet.vehicle(gateway, id), do: vehicle

    cond do
      vehicles == [] ->
        put_flash(socket, :error, "None of these vehicles is known any more.")

      length(vehicles) > Sheet.most() ->
        put_flash(socket, :error, "At most #{Sheet.most()} vehicles go together.")

      true ->
        socket |> assign(sheet: Sheet.new(Sheets.kind(name), vehicles), sheet_error: nil) |> look()
    end
  end

  @doc "What is done in the sheet; without one, nothing."
  @spec sheet(Socket.t(), event :: String.t(), value :: map()) :: Socket.t()
  def sheet(%{assigns: %{sheet: nil}} = socket, _event, _value), do: socket
  def sheet(socket, "sheet_close", _value), do: close(socket)
  def sheet(socket, "sheet_go", event), do: go(socket, event)

  def sheet(%{assigns: %{sheet: sheet}} = socket, "sheet_" <> event, value),
    do: socket |> assign(sheet: Sheet.event(sheet, event, value, ask(socket)), sheet_error: nil) |> look()

  @doc "After a message of a task that works something out for a sheet."
  @spec worked(Socket.t(), term()) :: Socket.t()
  def worked(%{assigns: %{working: {ref, key}}} = socket, {ref, result}) do
    Process.demonitor(ref, [:flush])
    put_worked(assign(socket, :working, nil), key, result)
  end

  def worked(%{assigns: %{working: {ref, key}}} = socket, {:DOWN, ref, :process, _pid, _crash}),
    do: put_worked(assign(socket, :working, nil), key, {:error, :crashed})

  def worked(socket, _earlier), do: socket

  defp put_worked(%{assigns: %{sheet: nil}} = socket, _key, _result), do: socket

  defp put_worked(%{assigns: %{sheet: sheet}} = socket, key, result),
    do: socket |> assign(:sheet, Sheet.worked(sheet, key, result)) |> look()

  # One at a time, for what the sheet shows by then.
  defp work(%{assigns: %{working: nil, sheet: sheet, facts: facts}} = socket) do
    case Sheet.work(sheet, facts) do
      {key, work} ->
        {page, ask} = {self(), ask(socket)}
        {:ok, pid} = Task.start(fn -> receive(do: (ref -> send(page, {ref, work.(ask)}))) end)
        ref = Process.monitor(pid)
        send(pid, ref)
        assign(socket, :working, {ref, key})

      _nothing ->
        socket
    end
  end

  defp work(socket), do: socket

  # Begins what a held press shows, if the sheet shows the same.
  defp go(socket, event) do
    %{assigns: %{sheet: sheet, facts: facts}} = socket = look(socket)
    shown = Sheet.shown(sheet, facts)
    refusal = Sheet.refusal(sheet, facts)

    cond do
      not Sheet.meant?(event, shown) ->
        assign(socket, :sheet_error, "What was shown has changed; nothing was sent. Look again, then hold.")

      refusal != nil ->
        assign(socket, :sheet_error, "Nothing was sent: #{refusal}")

      true ->
        with :ok <- Press.id(event["id"]),
             :ok <- Sheet.prepare(sheet, shown, facts, ask(socket)),
             {:ok, socket} <- begin(socket, Sheet.request(sheet, event["id"], shown, facts)) do
          socket |> clear_flash() |> close()
        else
          {:error, text} -> assign(socket, :sheet_error, "Nothing was sent: #{text}")
        end
    end
  end

  # What is known of its vehicles now, each at the height that the sheet has for it.
  defp look(%{assigns: %{gateway: gateway, sheet: sheet}} = socket) do
    facts = Sheet.facts(sheet, &Fleet.vehicle(gateway, &1), ask(socket))
    socket = socket |> assign(:facts, facts) |> work()
    routes = Sheet.preview(sheet, facts)
    if routes == socket.assigns.preview, do: socket, else: push_preview(socket, routes)
  end

  defp ask(%{assigns: %{gateway: gateway, user: user}}), do: Ask.of(gateway, user)

  defp close(socket), do: socket |> assign(sheet: nil, facts: %{}) |> push_preview([])

  defp push_preview(socket, routes) do
    socket |> assign(:preview, routes) |> push_event("map:preview", %{map: "fleet-map", routes: routes})
  end
end
