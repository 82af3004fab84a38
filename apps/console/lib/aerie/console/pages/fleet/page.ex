defmodule Aerie.Console.Pages.Fleet.Page do
  @moduledoc """
  The page of all vehicles: a map, and beside it a table whose width the browser keeps (hook `Splitter`). Filter and order
  are in the address.

  The map gets all changes, at most five times a second. For less than 40 vehicles the table's numbers change as often,
  from 40 each second time, and from 100 once a second, because nobody reads many rows five times a second; a change of
  a vehicle's state, mode, problems or holder still shows at once.
  """
  use Aerie.Console,
      {:page,
       events: [
         viewer:
           ~w(select all none again pointer sort_now filter flag sort plans map_select map_follow map_box map_escape
              group show_hidden strip)
       ],
       costly: ~w(all filter flag sort sort_now plans strip sheet_files)}

  import Aerie.Console.Pages.Fleet.{Actions, Table, Toolbar}
  import Aerie.Console.Map, only: [map: 1]

  alias Aerie.Fleet.Shadow

  alias Aerie.Console.Pages.Fleet.{Address, Board, Filter, OnMap, Order, Plans, Selection}
  alias Aerie.Console.Pages.Fleet.Act
  alias Aerie.Console.Pages.Fleet.Act.{Groups, Sheets}
  alias Aerie.Console.Pages.Fleet.Actions.ControlForms
  alias Aerie.Console.Pages.Fleet.Sequence
  alias Aerie.Console.Pages.Fleet.Actions.Tagging

  alias Aerie.Console.Pages.Replay.Strip

  @map "fleet-map"
  @rows_each_time 20
  # A second between two readings of the numbers.
  @most_rounds 5
  @sheets Sheets.names()
  @changed "The selection changed; nothing was sent."
  # Desired states take ten changes a second from one user.
  @tag_again_ms 200

  @impl Phoenix.LiveView
  def mount(_params, _session, socket) do
    {:ok,
     socket
     |> assign(page_title: "Fleet", filter: %Filter{}, order: {"id", :asc}, follow: nil)
     |> assign(
       selection: %Selection{},
       sequence: %Sequence{},
       hand: false,
       tagging: nil,
       plans: %Plans{},
       rows: [],
       all: [],
       choices: %{}
     )
     |> put_private(:fleet, %{
       seen: nil,
       ids: [],
       rows: %{},
       plans: [],
       counts: %{},
       current: %{},
       round: 0
     })
     |> subscribe([:vehicles, :links, :leases])
     |> Act.Live.mount()
     |> Strip.mount()
     |> OnMap.push_zones(@map)
     |> read()
     |> assign_view()}
  end

  @impl Phoenix.LiveView
  def handle_params(params, _uri, %{assigns: %{filter: filter, order: order}} = socket) do
    socket =
      socket |> assign(filter: Filter.parse(params), order: Order.parse(params["sort"])) |> tools()

    same? = {socket.assigns.filter, socket.assigns.order} == {filter, order}
    {:noreply, if(same?, do: assign_view(socket), else: sort(socket))}
  end

  @impl Phoenix.LiveView
  def handle_info(:refresh, socket) do
    due? = due?(socket)
    before = socket.assigns.all
    socket = read(socket, :recent, if(due?, do: :all, else: :urgent))

    socket =
      if due? or not :erts_debug.same(socket.assigns.all, before), do: assign_view(socket), else: socket

    socket = Act.Live.follow(socket)
    {:noreply, update_private(socket, &%{&1 | round: next(&1.round)})}
  end

  def handle_info({ref, _result} = message, socket) when is_reference(ref),
    do: {:noreply, Act.Live.worked(socket, message)}

  def handle_info({:DOWN, _ref, :process, _pid, _why} = message, socket),
    do: {:noreply, Act.Live.worked(socket, message)}

  def handle_info({:fleet, :leases, _change}, socket), do: {:noreply, socket |> read() |> assign_view()}

  def handle_info({:plan, id, ref, message}, socket) do
    {:noreply, socket |> update(:plans, &Plans.update(&1, id, ref, message)) |> tell_plans()}
  end

  def handle_info(:tag, %{assigns: %{tagging: %{left: [{id, words} | left]} = tagging} = assigns} = socket) do
    case Shadow.tag(assigns.gateway, id, words, assigns.user, "console") do
      :ok when left == [] ->
        {:noreply, socket |> assign(:tagging, nil) |> read() |> assign_view()}

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

  def handle_event("pointer", %{"over" => over} = event, socket) do
    shown = if is_list(event["ids"]), do: event["ids"], else: []
    sequence = Sequence.adopt(socket.assigns.sequence, shown)
    {:noreply, socket |> assign(hand: over == true, sequence: sequence) |> assign_view()}
  end

  def handle_event("sort_now", _value, socket), do: {:noreply, sort(socket)}

  def handle_event("filter", value, socket),
    do: {:noreply, patch(socket, filter: %{Filter.parse(value) | flags: socket.assigns.filter.flags})}

  def handle_event("flag", %{"flag" => name}, socket),
    do: {:noreply, patch(socket, filter: Filter.toggle(socket.assigns.filter, name))}

  def handle_event("sort", %{"by" => column}, socket),
    do: {:noreply, patch(socket, order: Order.press(socket.assigns.order, column))}

  def handle_event("map_follow", %{"id" => id}, socket) do
    {:noreply, assign(socket, :follow, Enum.find(ids(socket.assigns.all), &(&1 == id)))}
  end

  def handle_event("map_box", %{"ids" => meant, "less" => less}, %{assigns: %{all: all}} = socket)
      when is_list(meant) do
    known = for %{id: id} <- all, id in meant, do: id
    change = if less == true, do: &Selection.remove/2, else: &Selection.add/2
    {:noreply, update(socket, :selection, &change.(&1, known))}
  end

  # The missions of those that are selected, on the map.
  def handle_event("plans", event, socket) do
    %{assigns: %{gateway: gateway}, private: %{fleet: %{counts: counts}}} = socket

    {:noreply,
     meant(socket, event, fn chosen ->
       socket |> update(:plans, &Plans.toggle(&1, gateway, ids(chosen), counts)) |> tell_plans()
     end)}
  end

  def handle_event("command", %{"type" => type} = event, socket) do
    {:noreply,
     seen(socket, event, fn chosen ->
       Act.Live.command(socket, event, ControlForms.concerned(type, chosen, socket.assigns.user.name))
     end)}
  end

  # The button names those of the selected that it is for.
  def handle_event("sheet_" <> name, %{"of" => shown} = event, socket)
      when name in @sheets and is_list(shown) do
    {:noreply,
     seen(socket, event, fn chosen ->
       Act.Live.open(socket, name, for(%{id: id} <- chosen, id in shown, do: id))
     end)}
  end

  def handle_event("sheet_" <> _what = event, value, socket),
    do: {:noreply, Act.Live.sheet(socket, event, value)}

  def handle_event("height", event, socket),
    do: {:noreply, seen(socket, event, &Act.Live.height(socket, event, &1))}

  def handle_event("mode", event, socket),
    do: {:noreply, seen(socket, event, &Act.Live.mode(socket, event, &1))}

  def handle_event("group", %{"name" => name}, %{assigns: %{selection: selection, rows: rows}} = socket),
    do: {:noreply, assign(socket, :selection, Groups.select(selection, Groups.of(rows), name))}

  def handle_event("show_hidden", _value, socket), do: {:noreply, patch(socket, filter: %Filter{})}

  def handle_event("tag", event, socket),
    do: {:noreply, meant(socket, event, &assign(socket, :tagging, Tagging.new(&1)))}

  def handle_event("close_tags", _value, socket), do: {:noreply, assign(socket, :tagging, nil)}

  def handle_event("save_tags", %{"tags" => text}, %{assigns: %{tagging: %{left: []} = tagging}} = socket)
      when is_binary(text) do
    send(self(), :tag)
    {:noreply, assign(socket, :tagging, Tagging.save(tagging, text, socket.assigns.all))}
  end

  def handle_event("save_tags", _value, socket), do: {:noreply, socket}

  # A press is for the vehicles that its operator saw: what is selected by now may be others.
  defp meant(%{assigns: %{all: all, selection: selection}} = socket, event, act) do
    chosen = Selection.chosen(selection, all)

    cond do
      not Selection.meant?(event, ids(chosen)) ->
        put_flash(socket, :error, @changed)

      not ControlForms.meant?(event, chosen) ->
        put_flash(socket, :error, "Who is in charge changed; nothing was sent.")

      chosen == [] ->
        socket

      true ->
        act.(chosen)
    end
  end

  # The same, unless some of them are hidden by the filter: for a key and a button alike.
  defp seen(%{assigns: %{selection: selection}} = socket, event, act) do
    meant(socket, event, fn chosen ->
      case Selection.summary(selection, ids(chosen), ids(socket.assigns.rows)) do
        {_seen, nil} -> act.(chosen)
        {_seen, _hidden} -> put_flash(socket, :error, "Nothing was sent. #{Selection.hidden_refusal()}")
      end
    end)
  end

  defp select(socket, id, change) do
    if Enum.any?(socket.assigns.all, &(&1.id == id)), do: assign(socket, :selection, change.()), else: socket
  end

  defp patch(socket, changes) do
    %{filter: filter, order: order} = Map.merge(socket.assigns, Map.new(changes))
    push_patch(socket, to: Address.of(filter, order), replace: true)
  end

  # Takes what is new on the board and updates the map.
  defp read(%{assigns: %{gateway: gateway}, private: %{fleet: fleet}} = socket, age \\ :now, which \\ :all) do
    news = Board.Server.news(gateway, fleet.seen, age, which)

    socket
    |> update_private(&%{&1 | seen: news.seen})
    |> put_all(news)
    |> assign(choices: news.choices)
    |> tools()
    |> OnMap.push_vehicles(@map, news)
    |> missions(news.places)
  end

  defp put_all(%{private: %{fleet: %{ids: ids}}} = socket, %{ids: ids, rows: []}), do: socket

  defp put_all(%{private: %{fleet: fleet}} = socket, %{ids: ids, rows: rows}) do
    known = for row <- rows, into: fleet.rows, do: {row.id, row}
    known = if ids == fleet.ids, do: known, else: Map.take(known, ids)

    socket
    |> update_private(&%{&1 | ids: ids, rows: known})
    |> assign(all: Enum.map(ids, &Map.fetch!(known, &1)))
  end

  # How many items each mission has, and which one is flown to.
  defp missions(%{assigns: %{gateway: gateway}} = socket, places) do
    socket =
      if places do
        counts = Map.new(places.missions, fn {id, mission} -> {id, mission.total} end)

        current =
          for {id, %{current: number}} when number != nil <- places.missions, into: %{}, do: {id, number}

        update_private(socket, &Map.merge(&1, %{counts: counts, current: current}))
      else
        socket
      end

    socket
    |> update(:plans, &Plans.keep(&1, gateway, socket.private.fleet.counts))
    |> tell_plans()
  end

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

  # The order the user chose.
  defp sort(%{assigns: %{sequence: sequence}} = socket),
    do: put_rows(socket, Sequence.sort(sequence, ids(sorted(socket)), now_ms()))

  # Filters and sorts the rows for the table, but for those that keep their places.
  defp assign_view(%{assigns: %{hand: hand} = assigns} = socket) do
    known = socket.private.fleet.ids
    selection = Selection.keep(assigns.selection, known)
    held? = hand or Selection.size(selection) > 0
    sequence = Sequence.follow(assigns.sequence, ids(sorted(socket)), known, held?, now_ms())
    socket |> assign(:selection, selection) |> put_rows(sequence)
  end

  # A table that disappears takes the hand along.
  defp put_rows(%{assigns: %{hand: hand}} = socket, sequence) do
    rows = for id <- sequence.ids, row = socket.private.fleet.rows[id], do: row
    assign(socket, sequence: sequence, rows: rows, hand: hand and rows != [])
  end

  defp sorted(%{assigns: %{all: all, filter: filter, order: order}}),
    do: all |> Enum.filter(&Filter.shows?(filter, &1)) |> Order.sort(order)

  defp now_ms, do: System.monotonic_time(:millisecond)

  defp due?(%{assigns: %{rows: rows}, private: %{fleet: %{round: round}}}),
    do: rem(round, rows |> length() |> div(@rows_each_time) |> max(1) |> min(@most_rounds)) == 0

  # Pages that opened together, after a restart, read the numbers at different times from then on.
  defp next(0), do: :rand.uniform(@most_rounds)
  defp next(round), do: round + 1

  defp update_private(socket, change), do: put_private(socket, :fleet, change.(socket.private.fleet))

  defp ids(rows), do: Enum.map(rows, & &1.id)

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <div class="fleet">
      <h1 class="visually-hidden">Fleet</h1>
      <.map id="fleet-map" class="fleet-map" label="Map of all vehicles" selected={Selection.among(@selection, ids(@all))} follow={@follow} menu={OnMap.menu(Selection.among(@selection, ids(@all)), @gateway, @user)} box />
      <Strip.strip class="fleet-strip" />
      <.splitter />
      <section id="fleet-list" class="fleet-list" aria-label="Vehicles">
        {@tools}
        <.status all={@all} shown={length(@rows)} selected={Selection.size(@selection)} filter={@filter} sequence={@sequence} now={now_ms()} />
        <.empty :if={@all == []} icon="vehicle" title="No vehicle has been heard yet">
          Vehicles appear by themselves when their first heartbeat arrives. <.link navigate="/links">Links</.link> shows what is connected.
        </.empty>
        <.empty :if={@all != [] and @rows == []} icon="filter" title="No vehicle matches">
          <:action><.button patch={Address.of(%Filter{}, @order)}>Show all {length(@all)}</.button></:action>
        </.empty>
        <.vehicles :if={@rows != []} rows={@rows} heads={@heads} selection={@selection} filter={@filter} />
        <Groups.groups :if={@rows != []} groups={Groups.of(@rows)} selection={@selection} />
      </section>
      <.actions selection={@selection} all={@all} rows={@rows} user={@user} plans={@plans} />
      <.plan_words plans={@plans} />
      <Sheets.dialog_of sheet={@sheet} facts={@facts} error={@sheet_error} />
      <.tag_dialog :if={@tagging} tagging={@tagging} words={@choices.tags} />
    </div>
    """
  end
end
