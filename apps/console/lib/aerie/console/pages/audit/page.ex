defmodule Aerie.Console.Pages.Audit.Page do
  @moduledoc "The page of the audit log: all decisions about commands and their results, filtered, in pages, verified, exported."
  use Aerie.Console,
      {:page,
       role: :operator,
       events: [operator: ~w(filter older newest verify)],
       costly: ~w(filter older newest verify)}

  alias Aerie.Control.Policy.Audit
  alias Aerie.Control.Policy.Roles
  alias Aerie.Console.Clock
  alias Aerie.Console.Commands.{Catalog, Wording}
  alias Aerie.Access.WorkLimit

  @limit 50
  @own ~w(n at prev hash type decision source vehicle command reason rule result id digest role via says)
  @decisions ~w(allow deny)

  @impl Phoenix.LiveView
  def mount(_params, _session, %{assigns: %{user: user}} = socket) do
    {:ok,
     socket
     |> assign(
       page_title: "Audit",
       filter: %{"text" => "", "type" => "", "decision" => ""},
       before: nil,
       page: nil,
       error: nil,
       status: nil,
       seen: nil,
       reading: nil,
       verifying: nil,
       report: nil,
       admin?: Roles.at_least?(user.role, :admin)
     )
     |> subscribe([])
     |> load()}
  end

  # A link to one record shows it first.
  @impl Phoenix.LiveView
  def handle_params(%{"record" => text}, _uri, socket) when is_binary(text) do
    case Integer.parse(text) do
      {n, ""} when n in 1..1_000_000_000_000 -> {:noreply, socket |> assign(:before, n + 1) |> read()}
      _none -> {:noreply, socket}
    end
  end

  def handle_params(_params, _uri, socket), do: {:noreply, socket}

  @impl Phoenix.LiveView
  def handle_event("filter", params, socket) do
    filter = for key <- ~w(text type decision), into: %{}, do: {key, short(params[key])}
    {:noreply, socket |> assign(filter: filter, before: nil) |> read()}
  end

  def handle_event("older", _value, %{assigns: %{page: %{next: next}}} = socket) when next != nil,
    do: {:noreply, socket |> assign(:before, next) |> read()}

  def handle_event("newest", _value, socket), do: {:noreply, socket |> assign(:before, nil) |> read()}

  def handle_event("verify", _value, %{assigns: %{verifying: nil, status: %{dir: dir}}} = socket) do
    %{gateway: gateway, user: user} = socket.assigns

    task =
      Task.async(fn -> WorkLimit.run(gateway, :read, {:name, user.name}, fn -> Audit.verify(dir) end) end)

    {:noreply, assign(socket, verifying: task.ref, report: nil)}
  end

  def handle_event(_event, _value, socket), do: {:noreply, socket}

  defp short(text) when is_binary(text), do: String.slice(text, 0, 200)
  defp short(_other), do: ""

  @impl Phoenix.LiveView
  def handle_info(:refresh, socket), do: {:noreply, load(socket)}

  def handle_info({ref, {:ok, page}}, %{assigns: %{reading: ref}} = socket) do
    Process.demonitor(ref, [:flush])
    {:noreply, assign(socket, page: page, error: nil, reading: nil)}
  end

  def handle_info({ref, {:error, text}}, %{assigns: %{reading: ref}} = socket) do
    Process.demonitor(ref, [:flush])
    {:noreply, assign(socket, error: text, reading: nil)}
  end

  def handle_info({ref, result}, %{assigns: %{verifying: ref}} = socket) do
    Process.demonitor(ref, [:flush])
    socket = assign(socket, :verifying, nil)

    case result do
      {:ok, report} ->
        {:noreply, assign(socket, :report, report)}

      {:busy, seconds} ->
        {:noreply, put_flash(socket, :error, "Other files are being read: try again in #{seconds} s.")}
    end
  end

  def handle_info(_stray, socket), do: {:noreply, socket}

  # The newest page follows the log; older ones do not change.
  defp load(%{assigns: %{gateway: gateway, seen: seen, before: before, reading: reading}} = socket) do
    case Audit.status(gateway) do
      {:ok, status} ->
        socket = assign(socket, status: status, now: System.os_time(:microsecond))
        if status.n != seen and before == nil and reading == nil, do: read(socket), else: socket

      {:error, text} ->
        assign(socket, status: nil, error: text, now: System.os_time(:microsecond))
    end
  end

  # In a task, because a file of the log may have several megabytes.
  defp read(%{assigns: %{status: nil}} = socket), do: socket

  defp read(%{assigns: %{status: status, filter: filter, before: before}} = socket) do
    if connected?(socket) do
      query = %{
        before: before,
        limit: @limit,
        text: filter["text"],
        type: filter["type"],
        decision: filter["decision"]
      }

      task = Task.async(fn -> Audit.page(status.dir, query) end)
      assign(socket, reading: task.ref, seen: status.n)
    else
      socket
    end
  end

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <div class="spread page-title">
      <h1>Audit</h1>
      <div class="row">
        <.button phx-click="verify" icon="shield" disabled={@verifying != nil || @status == nil}>{if @verifying, do: "Verifying …", else: "Verify"}</.button>
        <.button :if={@admin?} href="/download/audit" icon="download" download="audit.jsonl">Export</.button>
      </div>
    </div>
    <.error :if={@error} title="The audit log cannot be read">{@error}</.error>
    <p :if={@status && @status.failing} class="notice bad" role="alert">
      <.icon name="alert" /> <span>The audit log cannot be written ({@status.failing}): {@status.missed} records are missing. Commands that must be recorded are refused.</span>
    </p>
    <p :if={@status && @status.n} class="muted">
      Record {@status.n}, {div(@status.bytes, 1024)} KiB in <code>{@status.dir}</code>, hash <code title={@status.hash}>{String.slice(@status.hash, 0, 16)}…</code>
    </p>
    <.report :if={@report} report={@report} />
    <form id="audit-filter" class="tools" phx-change="filter" phx-submit="filter" role="search">
      <.field id="audit-text" name="text" label="Text in any value" type="search" value={@filter["text"]} phx-debounce="300" autocomplete="off" />
      <.field id="audit-decision" name="decision" label="Decision" type="select" value={@filter["decision"]} options={[{"all", ""} | decisions()]} />
      <.field id="audit-type" name="type" label="Type" value={@filter["type"]} hint="decision, result, raw, link …" phx-debounce="300" />
    </form>
    <.loading :if={@page == nil && @error == nil} />
    <.empty :if={@page && @page.records == []} icon="audit" title="No record matches">{@page.searched} records searched</.empty>
    <.data_table :if={@page && @page.records != []} id="records" label="Records of the audit log" rows={@page.records} row_id={&"record-#{&1["n"]}"}>
      <:col
        :let={record} label="Time" class="audit-time"
      ><time title={record["at"]}>{Clock.stamp(record["at"])}</time></:col>
      <:col :let={record} label="Who">{value(record["source"])}</:col>
      <:col :let={record} label="Vehicle">{value(record["vehicle"])}</:col>
      <:col :let={record} label="What" class="grow"><strong>{what(record)}</strong> {params(record)}</:col>
      <:col
        :let={record} label="Outcome"
      ><.badge :if={outcome(record)} kind={kind(record)}>{outcome(record)}</.badge> {why(record)}</:col>
      <:col :let={record} label="Details">
        <details id={"details-#{record["n"]}"} phx-mounted={JS.ignore_attributes("open")}>
          <summary>No. {record["n"]}</summary>
          <dl class="facts">
            <div :for={{key, value} <- Enum.sort(record)}><dt>{key}</dt><dd>{value(value)}</dd></div>
          </dl>
        </details>
      </:col>
    </.data_table>
    <div :if={@page} class="row section">
      <.button :if={@before} phx-click="newest">Newest</.button>
      <.button :if={@page.next} phx-click="older" disabled={@reading != nil}>Older</.button>
      <span :if={@before} class="muted">Older records: not updated live</span>
    </div>
    """
  end

  attr :report, :any, required: true

  defp report(%{report: {:error, text}} = assigns) do
    assigns = assign(assigns, :text, text)

    ~H"""
    <p id="audit-report" class="notice bad" role="alert"><.icon name="alert" /> <span>Cannot be verified: {@text}</span></p>
    """
  end

  defp report(%{report: {:ok, report}} = assigns) do
    assigns = assign(assigns, :report, report)

    ~H"""
    <div id="audit-report" class={["notice", if(@report.problems == [], do: "info", else: "bad")]} role="status">
      <.icon name={if(@report.problems == [], do: "check", else: "alert")} />
      <div>
        <p>{if @report.problems == [], do: "The log is intact: #{@report.records} records in an unbroken chain.", else: "The log was changed:"}</p>
        <ul><li :for={line <- @report.problems ++ @report.notes}>{line}</li></ul>
        <p class="muted">Last hash <code>{@report.hash}</code>. Keep a copy elsewhere to prove later that nothing was cut off.</p>
      </div>
    </div>
    """
  end

  defp decisions, do: for(decision <- @decisions, do: {decision, decision})

  defp value(nil), do: ""
  defp value(value), do: Audit.format(value)

  # A command by its name for people, anything else by the record's type.
  defp what(%{"command" => command}) when is_binary(command), do: Catalog.title(command)
  defp what(%{"type" => type}), do: type |> value() |> String.replace("_", " ") |> String.capitalize()

  # In words, without what only programs compare; shortened, because the details have it in full.
  defp params(record) do
    of = if is_map(record["params"]), do: record["params"], else: Map.drop(record, @own)

    record["command"]
    |> value()
    |> Wording.params(of)
    |> String.slice(0, 200)
  end

  defp outcome(%{"decision" => "allow"}), do: "Allowed"
  defp outcome(%{"decision" => "deny"}), do: "Not allowed"

  defp outcome(%{"type" => "result", "result" => status}) when is_binary(status),
    do: String.capitalize(status)

  defp outcome(_note), do: nil

  defp kind(%{"decision" => "allow"}), do: "ok"
  defp kind(%{"decision" => "deny"}), do: "bad"
  defp kind(%{"result" => status}) when status in ["completed", "accepted"], do: "ok"
  defp kind(_other), do: "warn"

  defp why(record),
    do:
      [record["reason"], record["rule"] && "rule #{value(record["rule"])}"]
      |> Enum.filter(& &1)
      |> Enum.map_join(", ", &value/1)
end
