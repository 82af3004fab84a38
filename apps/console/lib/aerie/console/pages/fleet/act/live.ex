defmodule Aerie.Console.Pages.Fleet.Act.Live do
  @moduledoc """
  What the page of the fleet keeps of its acts: the sheet that is being prepared (`@sheet`, with `@facts` of its
  vehicles and `@sheet_error`). Each act is one operation of the gateway, so it goes on without the page, and the strip
  of all pages shows what becomes of it.
  """
  import Phoenix.Component, only: [assign: 2, assign: 3]
  import Phoenix.LiveView, only: [clear_flash: 1, put_flash: 3]

  alias Aerie.Console.Pages.Fleet.Act.{Height, Mode, Press, Return, Sheet, Sheets, TakeOff}
  alias Aerie.Console.Pages.Fleet.Act.Mission.Start
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
        socket |> assign(sheet: Sheets.module(name).new(vehicles), sheet_error: nil) |> look()
    end
  end

  @doc "What is done in the sheet; without one, nothing."
  @spec sheet(Socket.t(), event :: String.t(), value :: map()) :: Socket.t()
  def sheet(%{assigns: %{sheet: nil}} = socket, _event, _value), do: socket
  def sheet(socket, "sheet_close", _value), do: assign(socket, sheet: nil, facts: %{})
  def sheet(socket, "sheet_go", event), do: go(socket, event)

  def sheet(%{assigns: %{sheet: %module{} = sheet}} = socket, "sheet_" <> event, value),
    do: socket |> assign(sheet: module.event(sheet, event, value), sheet_error: nil) |> look()

  # Begins what a held press shows, if the sheet shows the same.
  defp go(socket, event) do
    %{assigns: %{sheet: %module{} = sheet, facts: facts}} = socket = look(socket)
    shown = module.shown(sheet, facts)
    refusal = module.refusal(sheet, facts)

    cond do
      not Sheet.meant?(event, shown) ->
        assign(socket, :sheet_error, "What was shown has changed; nothing was sent. Look again, then hold.")

      refusal != nil ->
        assign(socket, :sheet_error, "Nothing was sent: #{refusal}")

      true ->
        with :ok <- Press.id(event["id"]),
             {:ok, socket} <- begin(socket, request(socket, sheet, event["id"], shown)) do
          socket |> clear_flash() |> assign(sheet: nil, facts: %{})
        else
          {:error, text} -> assign(socket, :sheet_error, "Nothing was sent: #{text}")
        end
    end
  end

  defp request(%{assigns: %{gateway: gateway, facts: facts}}, %TakeOff{}, id, shown) do
    steps = &Fleet.take_off(Fleet.vehicle(gateway, &1) || facts[&1].snapshot, &2, &3, &4)
    TakeOff.request(id, shown, steps)
  end

  defp request(_socket, %Start{}, id, shown), do: Start.request(id, shown)

  defp request(_socket, %Return{}, id, shown), do: Return.request(id, shown, &Fleet.return_home/3)

  # What is known of its vehicles now, each at the height that the sheet has for it.
  defp look(%{assigns: %{gateway: gateway, sheet: sheet}} = socket) do
    vehicles = for id <- sheet.order, vehicle = Fleet.vehicle(gateway, id), do: vehicle
    assign(socket, :facts, facts(socket, sheet, vehicles))
  end

  defp facts(%{assigns: %{gateway: gateway, user: user}}, %TakeOff{} = sheet, vehicles) do
    readiness = Fleet.readinesses(gateway, vehicles, user.name)
    heights = for %{id: id, height: height} <- TakeOff.lines(sheet, %{}), into: %{}, do: {id, height}

    for %{id: id} = vehicle <- vehicles, into: %{} do
      {id,
       %{snapshot: vehicle, readiness: readiness[id], refusal: refusal(gateway, vehicle, heights[id], user)}}
    end
  end

  defp facts(%{assigns: %{gateway: gateway, user: user}}, %Start{}, vehicles) do
    for %{id: id} = vehicle <- vehicles, into: %{} do
      answer =
        Commands.lacks(vehicle, "mission_start", user) || check(gateway, id, "mission_start", %{}, user)

      {id, %{snapshot: vehicle, refusal: why(answer)}}
    end
  end

  defp facts(%{assigns: %{gateway: gateway, user: user}}, %Return{} = sheet, vehicles) do
    heights = for {id, n} <- Sheet.places(sheet), n != nil, into: %{}, do: {id, Return.height(sheet, n)}

    for %{id: id} = vehicle <- vehicles, into: %{} do
      climbs? = Commands.lacks(vehicle, "set_altitude", user) == nil

      wanted =
        [{"rtl", %{}}] ++
          if(climbs? and heights[id], do: [{"set_altitude", %{altitude: heights[id]}}], else: [])

      refusal =
        Enum.find_value(wanted, fn {type, params} ->
          why(Commands.lacks(vehicle, type, user) || check(gateway, id, type, params, user))
        end)

      {id, %{snapshot: vehicle, own: Fleet.own_return_m(gateway, id), climbs?: climbs?, refusal: refusal}}
    end
  end

  defp refusal(_gateway, _vehicle, nil, _user), do: nil

  defp refusal(gateway, vehicle, height, user) do
    lack = Commands.lacks(vehicle, "takeoff", user) || Commands.lacks(vehicle, "arm", user)

    case lack || check(gateway, vehicle.id, "takeoff", %{altitude: height}, user) do
      # It is armed first.
      {:deny, :firmware, _state} -> nil
      answer -> why(answer)
    end
  end

  defp why({:permission, _permission, reason}), do: reason
  defp why({:firmware, reason}), do: reason
  defp why({:deny, _rule, reason}), do: reason
  defp why({:error, errors}), do: Enum.join(errors, "; ")
  defp why(:allow), do: nil

  defp check(gateway, id, type, params, user),
    do: Commands.check(gateway, vehicle: id, type: type, params: params, as: user)
end
