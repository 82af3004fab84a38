defmodule Aerie.Console.Pages.Recordings.Page do
  @moduledoc """
  Recordings: the active ones, the files with download and deletion, and a file's events on a time line. An admin can play a file as a link of
  its own network, where its vehicles fly again beside the real ones.
  """
  use Aerie.Console,
      {:page,
       events: [viewer: ~w(events close), admin: ~w(ask cancel)],
       changes: [
         save: ~w(save),
         play_recording: ~w(play),
         remove_link: ~w(stop),
         delete_recording: ~w(delete)
       ],
       costly: ~w(events save)}

  alias Aerie.Base.Store
  alias MavRouter.{Link, Recorder}
  alias Aerie.Control.Policy.Roles
  alias Aerie.Access.Changes
  alias Aerie.Console.Clock
  alias Aerie.Console.Pages.Recordings.{TimeLine, TlogFile}
  alias Aerie.Console.UI.Age
  alias Aerie.Access.WorkLimit

  @max_files 200
  @speeds ~w(1 5 20 max)
  @network "replay"

  @impl Phoenix.LiveView
  def mount(_params, _session, %{assigns: %{user: user}} = socket) do
    {:ok,
     socket
     |> assign(
       page_title: "Recordings",
       admin?: Roles.at_least?(user.role, :admin),
       may_save?: Roles.at_least?(user.role, :operator),
       asking: nil,
       line: nil,
       reading: nil,
       listed: nil
     )
     |> subscribe([:links])
     |> load()}
  end

  # Only listed names are opened.
  @impl Phoenix.LiveView
  def handle_event("events", %{"name" => name}, %{assigns: %{reading: nil}} = socket) do
    case file(socket, name) do
      nil ->
        {:noreply, socket}

      file ->
        task = Task.async(fn -> read(socket.assigns, file) end)
        {:noreply, assign(socket, reading: {task.ref, name}, line: nil)}
    end
  end

  def handle_event("close", _value, socket), do: {:noreply, assign(socket, :line, nil)}

  def handle_event("save", %{"id" => id}, %{assigns: %{gateway: gateway}} = socket) when is_binary(id) do
    case Recorder.save(gateway, id, "console") do
      {:ok, path} ->
        note(socket, "save", Path.basename(path))
        {:noreply, socket |> put_flash(:info, "Saved as #{Path.basename(path)}.") |> load(:now)}

      {:error, error} ->
        {:noreply, put_flash(socket, :error, Exception.message(error))}
    end
  end

  def handle_event("play", %{"name" => name, "speed" => speed}, %{assigns: %{gateway: gateway}} = socket)
      when speed in @speeds do
    with %{path: path} <- file(socket, name),
         id = "replay-" <> name,
         {:ok, ^id} <- Link.start(gateway, "replay:#{path}?speed=#{speed}", id: id, network: @network) do
      note(socket, "play", name)
      {:noreply, socket |> put_flash(:info, "Playing #{name} on the network #{@network}.") |> load(:now)}
    else
      nil -> {:noreply, socket}
      {:error, error} -> {:noreply, put_flash(socket, :error, Exception.message(error))}
    end
  end

  def handle_event("stop", %{"id" => id}, %{assigns: %{gateway: gateway, playing: playing}} = socket) do
    if Enum.any?(playing, &(&1.id == id)) do
      :ok = Link.stop(gateway, id)
      note(socket, "stop", id)
    end

    {:noreply, load(socket, :now)}
  end

  def handle_event("ask", %{"name" => name}, socket) when is_binary(name),
    do: {:noreply, assign(socket, :asking, name)}

  def handle_event("cancel", _value, socket), do: {:noreply, assign(socket, :asking, nil)}

  def handle_event("delete", %{"name" => name}, %{assigns: %{asking: name, gateway: gateway}} = socket)
      when name != nil do
    socket = assign(socket, :asking, nil)

    case Recorder.delete(gateway, name) do
      :ok ->
        note(socket, "delete", name)
        {:noreply, socket |> put_flash(:info, "#{name} deleted.") |> load(:now)}

      {:error, error} ->
        {:noreply, put_flash(socket, :error, Exception.message(error))}
    end
  end

  def handle_event(_event, _value, socket), do: {:noreply, socket}

  defp read(%{gateway: gateway, user: user}, file) do
    case WorkLimit.run(gateway, :read, {:name, user.name}, fn -> TimeLine.read(file.path, file.bytes) end) do
      {:ok, result} -> result
      {:busy, seconds} -> {:error, "other files are being read: try again in #{seconds} s"}
    end
  end

  defp file(%{assigns: %{files: files}}, name), do: Enum.find(files, &(&1.name == name))

  defp note(%{assigns: %{gateway: gateway} = assigns}, what, name),
    do: Changes.note(gateway, Changes.user(assigns), "recording", %{"action" => what, "file" => name})

  @impl Phoenix.LiveView
  def handle_info(:refresh, socket), do: {:noreply, load(socket)}

  def handle_info({ref, result}, %{assigns: %{reading: {ref, name}}} = socket) do
    Process.demonitor(ref, [:flush])
    socket = assign(socket, :reading, nil)

    case result do
      {:ok, line} -> {:noreply, assign(socket, :line, Map.put(line, :name, name))}
      {:error, text} -> {:noreply, put_flash(socket, :error, "#{name}: #{text}")}
    end
  end

  def handle_info({:DOWN, ref, :process, _pid, _reason}, %{assigns: %{reading: {ref, name}}} = socket),
    do: {:noreply, socket |> assign(:reading, nil) |> put_flash(:error, "#{name} cannot be read")}

  def handle_info(_stray, socket), do: {:noreply, socket}

  # File sizes are read only every two seconds.
  defp load(socket, when_due \\ :due)

  defp load(%{assigns: %{gateway: gateway, listed: listed}} = socket, when_due) do
    now = System.monotonic_time(:millisecond)
    status = Recorder.status(gateway)
    playing = for %{kind: :replay} = link <- Store.links(gateway), do: Map.take(link, [:id, :status, :text])
    vehicles = for %{id: id} <- Store.vehicles(gateway), do: id

    socket =
      assign(socket, status: status, playing: playing, vehicles: vehicles, now: System.os_time(:microsecond))

    if when_due == :now or listed == nil or now - listed >= 2_000,
      do: socket |> assign(files: files(gateway, socket.assigns[:files] || []), listed: now),
      else: socket
  end

  # Only files that were not listed before are read.
  defp files(gateway, before) do
    starts = for %{start: start, path: path} when start != nil <- before, into: %{}, do: {path, start}

    for %{file: path} = file <- gateway |> Recorder.list() |> Enum.reverse() |> Enum.take(@max_files),
        do: %{
          name: Path.basename(path),
          path: path,
          bytes: file.bytes,
          at: file.at,
          open: file.open,
          start: starts[path] || TlogFile.start(path)
        }
  end

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <h1 class="page-title">Recordings</h1>
    <.error :if={@status == nil} title="The recorder is not running">It is off or is being restarted.</.error>
    <p :if={@status && match?(%{low: true}, @status.space)} class="notice bad" role="alert"><.icon name="alert" /> <span>Disk full ({@status.dir}): nothing is recorded.</span></p>
    <section :if={@playing != []}>
      <h2>Playing</h2>
      <ul class="stack"><li :for={link <- @playing} :key={link.id} id={"playing-#{:erlang.phash2(link.id)}"} class="card spread"><span><strong>{link.id}</strong> <span class="muted">{link.text}</span></span><.button :if={@admin?} small icon="stop" phx-click="stop" phx-value-id={link.id}>Stop</.button></li></ul>
    </section>
    <.time_line :if={@line} line={@line} />
    <.loading :if={@reading} title="Reading the recording" />
    <section class="section">
      <h2>Files</h2>
      <.empty :if={@files == []} icon="record" title="No recordings yet">Set <code>recorder.vehicles</code> to record vehicles while they are armed.</.empty>
      <.data_table :if={@files != []} id="files" label="Recordings" rows={@files} row_id={&"file-#{:erlang.phash2(&1.name)}"}>
        <:col :let={file} label="Recorded" class="grow"><strong>{TlogFile.label(file.name)}</strong> <.badge :if={file.open} kind="ok">recording</.badge> <span class="mono muted file-name">{file.name}</span></:col>
        <:col :let={file} label="Start" number>{Clock.stamp(file.start)}</:col>
        <:col :let={file} label="Duration" number>{duration(file)}</:col>
        <:col :let={file} label="Size" number>{TlogFile.size(file.bytes)}</:col>
        <:col :let={file} label="">
          <span class="row actions">
            <.button small phx-click="events" phx-value-name={file.name} disabled={@reading != nil}>Events</.button>
            <.button small icon="download" label={"Download #{file.name}"} href={"/download/recordings/" <> URI.encode(file.name)} download={file.name} />
            <form :if={@admin? && !file.open} phx-submit="play" phx-auto-recover="ignore" class="row" id={"play-#{:erlang.phash2(file.name)}"}>
              <input type="hidden" name="name" value={file.name} />
              <.field id={"speed-#{:erlang.phash2(file.name)}"} name="speed" label="Speed" label_hidden type="select" options={Enum.map(speeds(), &{speed(&1), &1})} />
              <.button small type="submit" icon="play" label={"Play #{file.name}"} />
            </form>
            <.button :if={@admin? && !file.open} small icon="trash" label={"Delete #{file.name}"} phx-click="ask" phx-value-name={file.name} />
          </span>
        </:col>
      </.data_table>
    </section>
    <section :if={@status} class="section">
      <h2>Recorder</h2>
      <p class="muted">Folder <code>{@status.dir}</code>{free(@status.space)}</p>
      <.data_table :if={@status.recordings != []} id="recordings" label="What is recorded" rows={@status.recordings} row_id={&"recording-#{:erlang.phash2(&1.target)}"}>
        <:col :let={row} label="What"><strong>{row.label}</strong></:col>
        <:col :let={row} label="State"><.badge kind={kind(row.state)}>{row.state}</.badge> {row.reason}</:col>
        <:col :let={row} label="File" class="grow">{row.file && Path.basename(row.file)}</:col>
        <:col :let={row} label="Frames" number>{row.frames}</:col>
        <:col :let={row} label="Dropped" number>{row.dropped}</:col>
      </.data_table>
      <div :if={@may_save? && @vehicles != [] && @status.rings != %{}} class="row section">
        <span>Save the last {Age.text(round(@status.ring_ms * 1000))} of</span>
        <.button :for={id <- Enum.take(@vehicles, 50)} small phx-click="save" phx-value-id={id}>{id}</.button>
      </div>
    </section>
    <.dialog :if={@asking && @admin?} id="delete-recording" title={"Delete #{@asking}"} cancel="cancel" kind="danger">
      <p>The file is deleted from the disk. This cannot be undone.</p>
      <:action><.button phx-click="cancel">Cancel</.button><.button kind="danger" phx-click="delete" phx-value-name={@asking}>Delete</.button></:action>
    </.dialog>
    """
  end

  attr :line, :map, required: true

  defp time_line(assigns) do
    ~H"""
    <section id="time-line" class="card section">
      <div class="spread">
        <h2 class="mono">{@line.name}</h2>
        <.button kind="quiet" icon="x" label="Close" phx-click="close" />
      </div>
      <p class="muted">
        {@line.from}, {@line.seconds} s, {@line.frames} frames, vehicles: {Enum.join(@line.vehicles, ", ")}{if @line.damaged > 0, do: ", #{@line.damaged} damaged parts"}
      </p>
      <svg class="track" viewBox="0 0 1000 20" preserveAspectRatio="none" role="img" aria-label={"#{length(@line.events)} events over #{@line.seconds} s"}>
        <line :for={event <- @line.events} x1={event.x} x2={event.x} y1="2" y2="18" class={event.tone}><title>{event.type} at {event.at} s</title></line>
      </svg>
      <.empty :if={@line.events == []} title="No events">This recording has no events.</.empty>
      <ol class="timeline-list">
        <li :for={event <- @line.events} :key={event.n} id={"event-#{event.n}"}><span class="mono">{event.at} s</span><strong>{event.vehicle}</strong><span>{event.text} <span class="muted mono">{event.type}</span></span></li>
      </ol>
      <p :if={@line.more > 0} class="muted">{@line.more} more events: <code>aerie replay FILE</code> lists all.</p>
    </section>
    """
  end

  defp speeds, do: @speeds

  defp speed("max"), do: "Maximum"
  defp speed(times), do: times <> "×"

  defp duration(%{start: nil}), do: "–"
  defp duration(file), do: Age.text(file.at * 1_000_000 - file.start)

  defp free(%{free: bytes}) when is_integer(bytes), do: ", #{TlogFile.size(bytes)} free"
  defp free(_unknown), do: ""

  defp kind(:recording), do: "ok"
  defp kind(:paused), do: "bad"
  defp kind(_waiting), do: "off"
end
