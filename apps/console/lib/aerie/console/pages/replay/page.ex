defmodule Aerie.Console.Pages.Replay.Page do
  @moduledoc """
  The last 24 hours: a time line with a row for each vehicle, and the map at a second of it. The browser moves through
  the time (`assets/hooks/replay.js`) and asks for chunks of two minutes; the page commands nothing.
  """
  use Aerie.Console, {:page, events: [viewer: ~w(chunk map_select map_follow map_escape)]}

  import Aerie.Console.Map, only: [map: 1]

  alias Aerie.Base.PubSub
  alias Aerie.Console.Clock
  alias Aerie.Console.Pages.Replay.{Overview, TimeLine}
  alias Aerie.Fleet

  @chunk_s 120
  @chunk_samples 30_000
  @overview_ms 60_000

  @impl Phoenix.LiveView
  def mount(_params, _session, socket) do
    now = System.os_time(:microsecond)
    if connected?(socket), do: send(self(), :overview)

    if connected?(socket) and socket.assigns.user.role == :admin,
      do: PubSub.subscribe(socket.assigns.gateway, {:notice, :incident})

    {:ok,
     assign(socket,
       page_title: "Replay",
       now: now,
       problem: nil,
       notes: [],
       reading: nil,
       since: nil,
       at: nil,
       vehicles: [],
       known: []
     )}
  end

  @impl Phoenix.LiveView
  def handle_params(params, _uri, socket) do
    vehicles =
      if is_binary(params["vehicles"]), do: String.split(params["vehicles"], ",", trim: true), else: []

    {:noreply, assign(socket, at: at(params["at"]), vehicles: Enum.take(vehicles, Overview.max_vehicles()))}
  end

  defp at(text) when is_binary(text) do
    case DateTime.from_iso8601(text) do
      {:ok, time, _offset} -> DateTime.to_unix(time)
      _none -> nil
    end
  end

  defp at(_none), do: nil

  @impl Phoenix.LiveView
  def handle_event("chunk", %{"from" => from}, %{assigns: %{gateway: gateway} = assigns} = socket)
      when is_integer(from) and rem(from, @chunk_s) == 0 and from > 0 and from < 100_000_000_000 do
    us = from * 1_000_000
    to = us + @chunk_s * 1_000_000 - 1

    vehicles =
      case Fleet.tracks(gateway, whose(assigns), us, to, 1, limit: @chunk_samples) do
        {:ok, %{vehicles: vehicles}} ->
          for {id, samples} <- vehicles, into: %{}, do: {id, TimeLine.rows(samples)}

        {:error, _text} ->
          %{}
      end

    {:noreply, push_event(socket, "replay:chunk", %{from: from, vehicles: vehicles})}
  end

  def handle_event(_event, _value, socket), do: {:noreply, socket}

  defp whose(%{vehicles: []}), do: :all
  defp whose(%{vehicles: ids}), do: ids

  @impl Phoenix.LiveView
  def handle_info(:overview, %{assigns: %{reading: nil} = assigns} = socket) do
    Process.send_after(self(), :overview, @overview_ms)
    now = System.os_time(:microsecond)
    %{gateway: gateway, user: user} = assigns
    whose = whose(assigns)

    {:noreply, assign(socket, reading: Overview.task(gateway, user, whose, now).ref, now: now)}
  end

  def handle_info(:overview, socket) do
    Process.send_after(self(), :overview, @overview_ms)
    {:noreply, socket}
  end

  def handle_info({ref, answer}, %{assigns: %{reading: ref}} = socket) do
    Process.demonitor(ref, [:flush])
    socket = assign(socket, :reading, nil)

    case answer do
      {:ok, {:ok, overview}} ->
        {:noreply,
         socket
         |> assign(problem: nil, notes: overview.notes, since: overview.since, known: overview.known)
         |> push_event("replay:overview", Map.drop(overview, [:notes, :since, :known]))}

      {:ok, {:error, text}} ->
        {:noreply, assign(socket, :problem, text)}

      {:busy, seconds} ->
        Process.send_after(self(), :overview, seconds * 1000)
        {:noreply, socket}
    end
  end

  def handle_info({:fleet, {:notice, :incident}, text}, socket),
    do: {:noreply, push_event(socket, "replay:packing", %{text: text})}

  def handle_info(_stray, socket), do: {:noreply, socket}

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <div
      id="replay"
      class="replay"
      phx-hook="Replay"
      data-at={@at}
      data-vehicles={Enum.join(@vehicles, ",")}
      data-chunk={chunk_s()}
    >
      <h1 class="visually-hidden">Replay</h1>
      <div class="replay-head">
        <p id="replay-badge" class="replay-badge" phx-update="ignore">
          <strong>REPLAY</strong> <span data-badge>…</span>
        </p>
        <div id="replay-tools" class="row" phx-update="ignore">
          <button type="button" class="button" data-play aria-pressed="false">Play</button>
          <label class="row">
            Speed
            <select data-speed>
              <option :for={speed <- [1, 2, 5, 10, 30, 60]} value={speed}>{speed} ×</option>
            </select>
          </label>
          <button type="button" class="button" data-before title="The event before (←)">◀ Event</button>
          <button type="button" class="button" data-after title="The next event (→)">Event ▶</button>
          <button type="button" class="button" data-out aria-label="Show a longer time">−</button>
          <button type="button" class="button" data-in aria-label="Show a shorter time">+</button>
        </div>
        <.link id="replay-live" class="button primary" navigate={back(@vehicles)}>Back to live (Esc)</.link>
      </div>
      <.error :if={@problem} title="There is no replay">{@problem}</.error>
      <.map
        id="replay-map"
        label="Where the vehicles were"
        tools={~w(in out north fit measure)}
        class="replay-map"
      />
      <div id="replay-line" class="time-line" phx-update="ignore"></div>
      <div id="replay-card" class="replay-card" role="status" phx-update="ignore"></div>
      <ul :if={@notes != []} class="muted"><li :for={note <- @notes}>{note}</li></ul>
      <p class="muted">
        ▲ critical △ warning ◆ command done ◇ refused ⌂ landed. Thin: heard; thick: in the air; hatched: lost; nothing:
        nothing is known. Times are UTC. <span :if={@since}>Kept from {Clock.full(@since)} on.</span>
      </p>
      <details :if={@known != []}>
        <summary>
          Vehicles: {if @vehicles == [], do: "all", else: "#{length(@vehicles)} of #{length(@known)}"}
        </summary>
        <form id={"replay-vehicles-#{:erlang.phash2(@known)}"} phx-update="ignore">
          <div class="replay-vehicles">
            <label :for={id <- @known}>
              <input type="checkbox" name="vehicle" value={id} checked={id in @vehicles} /> {id}
            </label>
          </div>
          <button type="submit" class="button">Show these, or all if none is ticked</button>
        </form>
      </details>
      <details id="replay-incident" phx-mounted={JS.ignore_attributes("open")}>
        <summary>Incident…</summary>
        <p>
          Recordings, events, commands with their decisions and the audit log of a vehicle in the time in view, in one
          archive with a page that plots it.
        </p>
        <p :if={@user.role != :admin} class="muted">
          <.icon name="lock" /> Only an admin packs it: it has parts of the audit log.
        </p>
        <form
          :if={@user.role == :admin and @known != []} id={"replay-pack-#{:erlang.phash2(@known)}"} class="row"
          phx-update="ignore" data-incident
        >
          <label class="row">
            Vehicle
            <select name="vehicle">
              <option :for={id <- @known} value={id} selected={id in @vehicles}>{id}</option>
            </select>
          </label>
          <button type="submit" class="button">Pack <span data-span></span></button>
          <span role="status" data-packing></span>
        </form>
      </details>
    </div>
    """
  end

  defp chunk_s, do: @chunk_s
  defp back([id]), do: "/vehicles/#{URI.encode(id, &URI.char_unreserved?/1)}"
  defp back(_vehicles), do: "/"
end
