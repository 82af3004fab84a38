defmodule FleetWeb.Console.Fleet.Page do
  @moduledoc """
  The page of all vehicles: a map beside a table. Filter, order and the part that a phone shows are in the address.

  The map gets all changes, at most five times a second. For up to 50 vehicles the table is rendered as often, for more vehicles less
  often, because nobody reads 200 rows five times a second; a change of a vehicle's state still shows at once.
  """
  use FleetWeb.Console,
      {:page,
       events: [
         viewer: ~w(select all none again filter flag sort plans map_select map_follow map_menu map_escape)
       ],
       costly: ~w(all filter flag sort plans)}

  import FleetWeb.Console.Fleet.{Actions, Table, Toolbar}
  import FleetWeb.Console.Map, only: [map: 1]

  alias Aerie.{Commands, Fleet, Policy, Protocol, Shadow, Store}
  alias Aerie.Policy.Leases
  alias Aerie.Shadow.Tags
  alias Aerie.Store.PubSub
  alias FleetWeb.Console.Fleet.{Batch, Charge, Filter, Order, Plans, Row, Selection}
  alias FleetWeb.Console.Map.{Payload, Tiles, Zones}

  @map "fleet-map"
  @rows_each_time 50
  # Desired states take ten changes a second from one user.
  @tag_again_ms 200

  @impl Phoenix.LiveView
  def mount(_params, _session, socket) do
    {:ok,
     socket
     |> assign(page_title: "Fleet", view: "map", filter: %Filter{}, order: {"id", :asc}, follow: nil)
     |> assign(
       selection: %Selection{},
       batch: nil,
       tagging: nil,
       plans: %Plans{},
       rows: [],
       all: [],
       words: []
     )
     |> put_private(:fleet, %{sent: %{}, homes: nil, plans: [], counts: %{}, current: %{}, round: 0})
     |> subscribe([:vehicles, :links, :leases])
     |> push_event("map:zones", %{map: @map, zones: Zones.of(Policy.Store.get(socket.assigns.gateway))})
     |> read()
     |> show()}
  end

  @impl Phoenix.LiveView
  def handle_params(params, _uri, socket) do
    {:noreply,
     socket
     |> assign(filter: Filter.parse(params), order: Order.parse(params["sort"]))
     |> assign(view: if(params["view"] == "table", do: "table", else: "map"))
     |> show()}
  end

  @impl Phoenix.LiveView
  def handle_info(:refresh, socket) do
    before = states(socket.assigns.all)
    socket = read(socket)
    socket = if due?(socket) or states(socket.assigns.all) != before, do: show(socket), else: socket
    {:noreply, update_private(socket, &%{&1 | round: &1.round + 1})}
  end

  def handle_info({:fleet, :leases, _change}, socket), do: {:noreply, socket |> read() |> show()}

  def handle_info({:plan, id, ref, message}, socket) do
    {:noreply, socket |> update(:plans, &Plans.update(&1, id, ref, message)) |> tell_plans()}
  end

  def handle_info({:submit, press}, %{assigns: %{batch: %{press: press} = batch}} = socket) do
    case Batch.next(batch) do
      nil ->
        {:noreply, socket}

      entry ->
        send(self(), {:submit, press})
        {:noreply, assign(socket, :batch, Batch.put(batch, entry.id, submit(socket, batch, entry)))}
    end
  end

  def handle_info({:submit, _earlier}, socket), do: {:noreply, socket}

  def handle_info(:tag, %{assigns: %{tagging: %{left: [{id, words} | left]} = tagging} = assigns} = socket) do
    case Shadow.tag(assigns.gateway, id, words, assigns.user, "console") do
      :ok when left == [] ->
        {:noreply, socket |> assign(:tagging, nil) |> read() |> show()}

      :ok ->
        send(self(), :tag)
        {:noreply, assign(socket, :tagging, %{tagging | left: left})}

      {:error, {:rate, _text}} ->
        Process.send_after(self(), :tag, @tag_again_ms)
        {:noreply, socket}

      {:error, refusal} ->
        {:noreply, assign(socket, :tagging, %{tagging | left: [], error: "#{id}: #{Shadow.text(refusal)}"})}
    end
  end

  # The dialog was closed: vehicles that were left keep their tags.
  def handle_info(:tag, socket), do: {:noreply, socket}

  def handle_info({:fleet, {:commands, vehicle}, id}, %{assigns: %{batch: batch, gateway: gateway}} = socket) do
    with %{} <- Batch.find(batch, id),
         {:ok, result} <- Commands.look(gateway, vehicle, id) do
      PubSub.unsubscribe(gateway, {:commands, vehicle})
      {:noreply, assign(socket, :batch, Batch.put(batch, id, {:done, result.status, result.reason}))}
    else
      _other_or_under_way -> {:noreply, socket}
    end
  end

  @impl Phoenix.LiveView
  def handle_event("select", %{"id" => id, "how" => how}, socket) do
    %{selection: selection, rows: rows} = socket.assigns

    {:noreply,
     select(socket, id, fn ->
       case how do
         "only" -> Selection.only(selection, id)
         "range" -> Selection.range(selection, id, ids(rows))
         _toggle -> Selection.toggle(selection, id)
       end
     end)}
  end

  def handle_event("map_select", %{"id" => id} = value, socket) do
    how = if value["add"] == true, do: :toggle, else: :only
    {:noreply, select(socket, id, fn -> apply(Selection, how, [socket.assigns.selection, id]) end)}
  end

  def handle_event("all", _value, %{assigns: %{selection: selection, rows: rows}} = socket),
    do: {:noreply, assign(socket, :selection, Selection.all(selection, ids(rows)))}

  def handle_event(none, _value, socket) when none in ["none", "map_escape"],
    do: {:noreply, assign(socket, :selection, %Selection{})}

  # The browser kept the selection of an earlier page.
  def handle_event("again", %{"ids" => ids}, socket) when is_list(ids) do
    known = Selection.among(%Selection{ids: MapSet.new(ids)}, ids(socket.assigns.all))
    {:noreply, assign(socket, :selection, %Selection{ids: MapSet.new(known)})}
  end

  def handle_event("filter", value, socket),
    do: {:noreply, patch(socket, filter: %{Filter.parse(value) | flags: socket.assigns.filter.flags})}

  def handle_event("flag", %{"flag" => name}, socket),
    do: {:noreply, patch(socket, filter: Filter.toggle(socket.assigns.filter, name))}

  def handle_event("sort", %{"by" => column}, socket),
    do: {:noreply, patch(socket, order: Order.press(socket.assigns.order, column))}

  def handle_event("map_follow", %{"id" => id}, socket) do
    {:noreply, assign(socket, :follow, Enum.find(ids(socket.assigns.all), &(&1 == id)))}
  end

  def handle_event("map_menu", _place, socket), do: {:noreply, socket}

  # The missions of those that are selected, on the map.
  def handle_event("plans", _value, %{assigns: %{gateway: gateway, selection: selection, all: all}} = socket) do
    case Selection.among(selection, ids(all)) do
      [] ->
        {:noreply, socket}

      ids ->
        counts = socket.private.fleet.counts
        {:noreply, socket |> update(:plans, &Plans.toggle(&1, gateway, ids, counts)) |> tell_plans()}
    end
  end

  def handle_event("command", %{"type" => type, "id" => press} = event, socket) do
    %{selection: selection, all: all, gateway: gateway, batch: last, user: user} = socket.assigns
    chosen = for row <- all, row.id in selection.ids, do: row

    case Batch.new(press, type, Charge.concerned(type, chosen, user.name), params(event)) do
      {:ok, %{press: press} = batch} when last == nil or last.press != press ->
        forget(gateway, last)
        for entry <- batch.entries, do: PubSub.subscribe(gateway, {:commands, entry.vehicle})
        send(self(), {:submit, press})
        {:noreply, assign(socket, :batch, batch)}

      _twice_or_wrong ->
        {:noreply, socket}
    end
  end

  def handle_event("close_batch", _value, socket) do
    forget(socket.assigns.gateway, socket.assigns.batch)
    {:noreply, assign(socket, :batch, nil)}
  end

  def handle_event("tag", _value, socket) do
    chosen = for row <- socket.assigns.all, row.id in socket.assigns.selection.ids, do: row

    case Enum.map(chosen, &MapSet.new(&1.tags)) do
      [] ->
        {:noreply, socket}

      tags ->
        common = tags |> Enum.reduce(&MapSet.intersection/2) |> Enum.sort()
        text = Enum.join(common, ", ")
        {:noreply, assign(socket, :tagging, %{text: text, common: common, error: nil, left: []})}
    end
  end

  def handle_event("close_tags", _value, socket), do: {:noreply, assign(socket, :tagging, nil)}

  def handle_event("save_tags", %{"tags" => text}, %{assigns: %{tagging: %{left: []} = tagging}} = socket)
      when is_binary(text) do
    %{all: all, selection: selection} = socket.assigns
    words = text |> String.split(",") |> Tags.tidy()

    # Tags that only some of the vehicles have stay theirs.
    left = for row <- all, row.id in selection.ids, do: {row.id, words ++ (row.tags -- tagging.common)}
    send(self(), :tag)
    {:noreply, assign(socket, :tagging, %{tagging | text: text, error: nil, left: left})}
  end

  def handle_event("save_tags", _value, socket), do: {:noreply, socket}

  # The table of commands checks them.
  defp params(%{"fields" => %{"reason" => reason}}) when is_binary(reason), do: %{"reason" => reason}
  defp params(_event), do: %{}

  defp submit(%{assigns: %{gateway: gateway, user: user}}, batch, %{vehicle: vehicle, id: id}) do
    envelope = %{"id" => id, "vehicle" => vehicle, "type" => batch.type, "params" => batch.params}

    case Commands.submit(gateway, envelope, user, via: "console", wait_ms: 0) do
      {:ok, result} -> {:done, result.status, result.reason}
      {:pending, _id} -> :under_way
      {:error, errors} -> {:done, :rejected, Aerie.Command.Error.text(errors)}
    end
  end

  defp forget(_gateway, nil), do: :ok

  defp forget(gateway, batch),
    do: Enum.each(batch.entries, &PubSub.unsubscribe(gateway, {:commands, &1.vehicle}))

  defp select(socket, id, change) do
    if Enum.any?(socket.assigns.all, &(&1.id == id)), do: assign(socket, :selection, change.()), else: socket
  end

  defp patch(socket, changes) do
    %{filter: filter, order: order, view: view} = Map.merge(socket.assigns, Map.new(changes))
    push_patch(socket, to: address(filter, order, view), replace: true)
  end

  @doc false
  @spec address(Filter.t(), Order.t(), String.t()) :: String.t()
  def address(filter, order, view) do
    sort = if column = Order.param(order), do: [{"sort", column}], else: []
    view = if view == "table", do: [{"view", view}], else: []

    case Filter.params(filter) ++ sort ++ view do
      [] -> "/"
      params -> "/?" <> URI.encode_query(params)
    end
  end

  # Reads the read model and updates the map.
  defp read(%{assigns: %{gateway: gateway}} = socket) do
    now = System.os_time(:microsecond)
    links = Store.links(gateway)
    tags = Shadow.tags(gateway)
    vehicles = Fleet.vehicles(gateway)
    leases = Leases.all(gateway)

    socket
    |> assign(:all, for(vehicle <- vehicles, do: Row.new(vehicle, links, tags, now, leases)))
    |> assign(:words, Tags.words(tags))
    |> tell_map(vehicles)
    |> missions(vehicles)
  end

  # How many items each mission has, and which one is flown to.
  defp missions(%{assigns: %{plans: plans, gateway: gateway}} = socket, vehicles) do
    told = Map.new(vehicles, &{&1.id, get_in(&1.groups, [:mission, :data]) || %{}})
    counts = Map.new(told, fn {id, mission} -> {id, mission[:total]} end)

    current =
      for vehicle <- vehicles, seq = told[vehicle.id][:seq], into: %{}, do: {vehicle.id, number(vehicle, seq)}

    socket
    |> update_private(&Map.merge(&1, %{counts: counts, current: current}))
    |> assign(:plans, Plans.keep(plans, gateway, counts))
    |> tell_plans()
  end

  # Of the item, counted from 1.
  defp number(vehicle, seq), do: seq - Protocol.of(vehicle.autopilot).item_offset()

  defp tell_plans(%{assigns: %{plans: plans}, private: %{fleet: %{plans: sent, current: current}}} = socket) do
    case Plans.payload(plans, current) do
      ^sent ->
        socket

      payload ->
        socket
        |> update_private(&%{&1 | plans: payload})
        |> push_event("map:plans", %{map: @map, plans: payload})
    end
  end

  defp tell_map(socket, vehicles) do
    if connected?(socket) do
      {payload, sent} =
        Payload.changes(
          socket.private.fleet.sent,
          Enum.flat_map(vehicles, &List.wrap(maybe(Payload.row(&1))))
        )

      homes = Payload.homes(vehicles)
      socket = if payload, do: push_event(socket, "map:vehicles", Map.put(payload, :map, @map)), else: socket

      socket =
        if homes != socket.private.fleet.homes,
          do: push_event(socket, "map:homes", %{map: @map, homes: homes}),
          else: socket

      update_private(socket, &%{&1 | sent: sent, homes: homes})
    else
      socket
    end
  end

  defp maybe(nil), do: nil
  defp maybe(row), do: [row]

  # Filters and sorts the rows for the table.
  defp show(%{assigns: %{all: all, filter: filter, order: order}} = socket) do
    socket
    |> assign(:rows, all |> Enum.filter(&Filter.shows?(filter, &1)) |> Order.sort(order))
    |> assign(:selection, Selection.keep(socket.assigns.selection, ids(all)))
  end

  defp due?(%{assigns: %{rows: rows}, private: %{fleet: %{round: round}}}),
    do: rem(round, max(1, div(length(rows), @rows_each_time))) == 0

  defp states(rows), do: for(row <- rows, do: {row.id, row.state, row.mode, row.problems, row.holder})

  defp update_private(socket, change), do: put_private(socket, :fleet, change.(socket.private.fleet))

  defp ids(rows), do: Enum.map(rows, & &1.id)

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <div class="fleet" data-view={@view}>
      <h1 class="visually-hidden">Fleet</h1>
      <div class="fleet-tabs">
        <.tabs label="Map or table">
          <:tab patch={address(@filter, @order, "map")} current={@view == "map"} icon="map">Map</:tab>
          <:tab patch={address(@filter, @order, "table")} current={@view == "table"} icon="list">Table ({length(@all)})</:tab>
        </.tabs>
      </div>
      <.map id="fleet-map" class="fleet-map" label="Map of all vehicles" tiles={Tiles.shown(@gateway)} selected={Selection.among(@selection, ids(@all))} follow={@follow} />
      <section class="fleet-list" aria-label="Vehicles">
        <.toolbar filter={@filter} all={@all} shown={length(@rows)} selected={Selection.size(@selection)} words={@words} />
        <.actions selection={@selection} all={@all} user={@user} batch={@batch} plans={@plans} />
        <.empty :if={@all == []} icon="vehicle" title="No vehicle has been heard yet">
          Vehicles appear by themselves when their first heartbeat arrives. <.link navigate="/links">Links</.link> shows what is connected.
        </.empty>
        <.empty :if={@all != [] and @rows == []} icon="filter" title="No vehicle matches">
          <:action><.button patch={address(%Filter{}, @order, @view)}>Show all {length(@all)}</.button></:action>
        </.empty>
        <.stale :if={@all != [] and Enum.all?(@all, &(&1.status != :online))}>No vehicle is heard. What you see is what was last known.</.stale>
        <.vehicles :if={@rows != []} rows={@rows} order={@order} selection={@selection} />
      </section>
      <.tag_dialog :if={@tagging} tagging={@tagging} count={Selection.size(@selection)} words={@words} />
    </div>
    """
  end
end
