defmodule Aerie.Console.Pages.Fleet.Act.Live do
  @moduledoc """
  What the page of the fleet keeps of its acts: the sheet that is being prepared (`@sheet`, with `@facts` of its
  vehicles and `@sheet_error`). Each act is one operation of the gateway, so it goes on without the page, and the strip
  of all pages shows what becomes of it.
  """
  import Phoenix.Component, only: [assign: 2, assign: 3]
  import Phoenix.LiveView, only: [clear_flash: 1, put_flash: 3]

  alias Aerie.Console.Pages.Fleet.Act.{Height, Press, TakeOff}
  alias Aerie.Control.Commands
  alias Aerie.Fleet
  alias Aerie.Vehicle.Snapshot
  alias Phoenix.LiveView.Socket

  @doc "Without a sheet."
  @spec mount(Socket.t()) :: Socket.t()
  def mount(socket), do: assign(socket, sheet: nil, facts: %{}, sheet_error: nil)

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

  @doc "Opens the sheet for a take-off of these vehicles."
  @spec open(Socket.t(), [String.t()]) :: Socket.t()
  def open(%{assigns: %{gateway: gateway}} = socket, ids) do
    vehicles = for id <- ids, vehicle = Fleet.vehicle(gateway, id), do: vehicle

    cond do
      vehicles == [] ->
        put_flash(socket, :error, "None of these vehicles is known any more.")

      length(vehicles) > TakeOff.most() ->
        put_flash(socket, :error, "At most #{TakeOff.most()} vehicles take off together.")

      true ->
        socket |> assign(sheet: TakeOff.new(vehicles), sheet_error: nil) |> look()
    end
  end

  @doc "What is done in the sheet; without one, nothing."
  @spec sheet(Socket.t(), event :: String.t(), value :: map()) :: Socket.t()
  def sheet(%{assigns: %{sheet: nil}} = socket, _event, _value), do: socket
  def sheet(socket, "sheet_close", _value), do: assign(socket, sheet: nil, facts: %{})

  def sheet(%{assigns: %{sheet: sheet}} = socket, event, value) do
    sheet =
      case {event, value} do
        {"sheet_change", fields} -> TakeOff.change(sheet, fields)
        {"sheet_move", %{"id" => id, "to" => to}} -> TakeOff.move(sheet, id, to)
        {"sheet_leave", %{"id" => id}} -> TakeOff.leave(sheet, id)
        {"sheet_anyway", %{"id" => id}} -> TakeOff.anyway(sheet, id)
        _unknown -> sheet
      end

    socket |> assign(sheet: sheet, sheet_error: nil) |> look()
  end

  @doc "Begins the take-off that a held press shows, if the sheet shows the same."
  @spec take_off(Socket.t(), event :: map()) :: Socket.t()
  def take_off(%{assigns: %{sheet: nil}} = socket, _event), do: socket

  def take_off(socket, event) do
    %{assigns: %{sheet: sheet, facts: facts, gateway: gateway}} = socket = look(socket)
    lines = TakeOff.lines(sheet, facts)
    shown = TakeOff.shown(sheet, lines)
    refusal = TakeOff.refusal(sheet, lines, TakeOff.nearest(lines, facts))

    cond do
      not TakeOff.meant?(event, shown) ->
        assign(socket, :sheet_error, "What was shown has changed; nothing was sent. Look again, then hold.")

      refusal != nil ->
        assign(socket, :sheet_error, "Nothing was sent: #{refusal}")

      true ->
        steps = &Fleet.take_off(Fleet.vehicle(gateway, &1) || facts[&1].snapshot, &2, &3, &4)

        with :ok <- Press.id(event["id"]),
             {:ok, socket} <- begin(socket, TakeOff.request(event["id"], shown, steps)) do
          socket |> clear_flash() |> assign(sheet: nil, facts: %{})
        else
          {:error, text} -> assign(socket, :sheet_error, "Nothing was sent: #{text}")
        end
    end
  end

  # What is known of its vehicles now, each at the height that the sheet has for it.
  defp look(%{assigns: %{gateway: gateway, user: user, sheet: sheet}} = socket) do
    vehicles = for id <- sheet.order, vehicle = Fleet.vehicle(gateway, id), do: vehicle
    readiness = Fleet.readinesses(gateway, vehicles, user.name)
    heights = for %{id: id, height: height} <- TakeOff.lines(sheet, %{}), into: %{}, do: {id, height}

    facts =
      for %{id: id} = vehicle <- vehicles, into: %{} do
        {id,
         %{snapshot: vehicle, readiness: readiness[id], refusal: refusal(gateway, vehicle, heights[id], user)}}
      end

    assign(socket, :facts, facts)
  end

  defp refusal(_gateway, _vehicle, nil, _user), do: nil

  defp refusal(gateway, vehicle, height, user) do
    lack = Commands.lacks(vehicle, "takeoff", user) || Commands.lacks(vehicle, "arm", user)

    case lack || check(gateway, vehicle.id, height, user) do
      {:permission, _permission, reason} -> reason
      # It is armed first.
      {:deny, :firmware, _state} -> nil
      {:firmware, reason} -> reason
      {:deny, _rule, reason} -> reason
      {:error, errors} -> Enum.join(errors, "; ")
      :allow -> nil
    end
  end

  defp check(gateway, id, height, user),
    do: Commands.check(gateway, vehicle: id, type: "takeoff", params: %{altitude: height}, as: user)
end
