defmodule Aerie.Console.Pages.Diagnosis.Page do
  @moduledoc "The page of the diagnosis: each problem with its evidence and what to do (`Aerie.Fleet.Diagnosis`)."
  use Aerie.Console, {:page, events: [viewer: ~w(show)]}

  alias Aerie.Base.Names
  alias Aerie.Fleet.Diagnosis
  alias Aerie.Console.UI.Age

  @severities ~w(error warning notice)

  @impl Phoenix.LiveView
  def mount(_params, _session, socket),
    do: {:ok, socket |> assign(page_title: "Diagnosis", severity: nil) |> subscribe([]) |> load()}

  @impl Phoenix.LiveView
  def handle_event("show", %{"severity" => severity}, socket) when severity in @severities,
    do: {:noreply, socket |> assign(:severity, severity) |> load()}

  def handle_event("show", _all, socket), do: {:noreply, socket |> assign(:severity, nil) |> load()}

  @impl Phoenix.LiveView
  def handle_info(:refresh, socket), do: {:noreply, load(socket)}

  defp load(%{assigns: %{gateway: gateway, severity: severity}} = socket) do
    all = Diagnosis.list(gateway)
    shown = if severity, do: Enum.filter(all, &(Atom.to_string(&1.severity) == severity)), else: all

    assign(socket,
      running?: Names.whereis(gateway, :diagnosis) != nil,
      counts: Enum.frequencies_by(all, &Atom.to_string(&1.severity)),
      total: length(all),
      conditions: shown,
      now: System.os_time(:microsecond)
    )
  end

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <div class="spread page-title">
      <h1>Diagnosis</h1>
      <div class="row" role="group" aria-label="Show">
        <.button small phx-click="show" phx-value-severity="all" aria-pressed={pressed(@severity == nil)}>All {@total}</.button>
        <.button :for={severity <- severities()} small phx-click="show" phx-value-severity={severity} aria-pressed={pressed(@severity == severity)}>
          {label(severity)} {Map.get(@counts, severity, 0)}
        </.button>
      </div>
    </div>
    <.error :if={!@running?} title="The diagnosis is not running">It restarts by itself. If this message stays, check the gateway's log.</.error>
    <.empty :if={@running? && @conditions == []} icon="check" title={if(@total == 0, do: "No problems", else: "No match")}>
      Wrong baud rates, one-way links, duplicate system ids, full disks and other faults appear here with their evidence, some after up to
      half a minute.
    </.empty>
    <ol class="conditions">
      <li :for={condition <- @conditions} :key={id(condition)} id={id(condition)} class={["card condition", kind(condition.severity)]}>
        <div class="spread">
          <h2><.badge kind={kind(condition.severity)}>{condition.severity}</.badge> {condition.title}</h2>
          <span class="muted">for {Age.text(@now - condition.since)}</span>
        </div>
        <dl class="facts">
          <dt>Concerns</dt>
          <dd><.subject subject={condition.subject} /></dd>
          <dt>Evidence</dt>
          <dd><ul><li :for={line <- condition.evidence}>{line}</li></ul></dd>
          <dt>What to do</dt>
          <dd>{condition.mend}</dd>
          <dt>Name</dt>
          <dd><code>{condition.name}</code></dd>
        </dl>
      </li>
    </ol>
    """
  end

  attr :subject, :any, required: true

  defp subject(%{subject: {:vehicle, id}} = assigns) do
    assigns = assign(assigns, id: id, to: "/vehicles/" <> URI.encode(id, &URI.char_unreserved?/1))

    ~H"""
    vehicle <.link navigate={@to}>{@id}</.link>
    """
  end

  defp subject(%{subject: {:link, id}} = assigns) do
    assigns = assign(assigns, id: id, to: "/links?" <> URI.encode_query(link: id))

    ~H"""
    link <.link navigate={@to}>{@id}</.link>
    """
  end

  defp subject(%{subject: {:client, id}} = assigns) do
    assigns = assign(assigns, :id, id)

    ~H"""
    client {@id}
    """
  end

  defp subject(assigns) do
    ~H"""
    the gateway
    """
  end

  defp severities, do: @severities
  defp label("error"), do: "Errors"
  defp label("warning"), do: "Warnings"
  defp label("notice"), do: "Notices"

  defp kind(:error), do: "bad"
  defp kind(:warning), do: "warn"
  defp kind(:notice), do: "info"

  defp pressed(on?), do: to_string(on?)
  # Link ids may contain any characters.
  defp id(%{name: name, subject: subject}), do: "condition-#{name}-#{:erlang.phash2(subject)}"
end
