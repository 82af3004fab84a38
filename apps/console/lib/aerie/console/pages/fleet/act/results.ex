defmodule Aerie.Console.Pages.Fleet.Act.Results do
  @moduledoc """
  What became of an operation on the selected vehicles, in words of what was reached: a landing is *Landing* until the
  vehicle has landed. Pure but for the component. The operation is the server's, so every page shows the same, and a
  page that is loaded again finds it.
  """
  use Aerie.Console, :component

  alias Aerie.Console.Commands.Entry
  alias Aerie.Console.Pages.Fleet.Board.Row

  @enforce_keys [:operation]
  defstruct [:operation, done: %{}]

  @typedoc """
    * `:operation` - of `Aerie.Fleet.operation/2`
    * `:done` - how each vehicle went on that has done what it was told: the mode in which it began, whether the row
      showed that mode already, and what ended it
  """
  @type t :: %__MODULE__{
          operation: map(),
          done: %{String.t() => %{mode: String.t() | nil, seen?: boolean(), ended: nil | :landed | :left}}
        }
  @type entry :: %{vehicle: String.t(), kind: String.t(), word: String.t(), reason: String.t() | nil}

  # What a vehicle of a sequence does.
  @steps %{
    "set_mode" => "Setting mode",
    "arm" => "Arming",
    "takeoff" => "Climbing",
    "wait_above" => "Climbing",
    "wait_alone" => "Waiting"
  }
  # More of them would be a list that nobody reads.
  @most 100
  # The operation's end was not long ago, for a page that has just been opened.
  @recent_s 60

  @doc "The results with an operation as it stands now; `last` are those of the page. `mode` gives a vehicle's mode."
  @spec new(t() | nil, operation :: map(), (String.t() -> String.t() | nil)) :: t()
  def new(last, %{"id" => id} = operation, mode) do
    results = if match?(%{operation: %{"id" => ^id}}, last), do: last, else: %__MODULE__{operation: operation}

    for {id, %{"state" => "ok"}} <- operation["vehicles"],
        not is_map_key(results.done, id),
        reduce: %{results | operation: operation},
        do: (results -> put_in(results.done[id], %{mode: mode.(id), seen?: false, ended: nil}))
  end

  @doc "The same after the rows of vehicles, by id, have changed."
  @spec follow(t(), %{String.t() => Row.t()}) :: t()
  def follow(results, rows) do
    for {id, %{ended: nil} = done} <- results.done, row = rows[id], reduce: results do
      results -> put_in(results.done[id], followed(done, row))
    end
  end

  # A return ends in a landing, and some firmwares show that as a mode.
  defp followed(%{mode: mode} = done, %{mode: now, in_air: in_air}) do
    same? = now in [nil, mode] or mode == nil or String.contains?(now, ["LAND", "RTL"])

    cond do
      not same? and done.seen? -> %{done | ended: :left}
      same? and in_air == false -> %{done | ended: :landed, seen?: true}
      true -> %{done | seen?: done.seen? or same?}
    end
  end

  @doc "The latest operation of somebody that runs, or has ended just now; nil for none. `now`: unix seconds."
  @spec latest([map()], name :: String.t(), now :: integer()) :: String.t() | nil
  def latest(operations, name, now) do
    Enum.find_value(operations, fn operation ->
      if operation["source"] == name and recent?(operation["done_at"], now), do: operation["id"]
    end)
  end

  defp recent?(nil, _now), do: true

  defp recent?(text, now) do
    case DateTime.from_iso8601(text) do
      {:ok, at, _offset} -> now - DateTime.to_unix(at) <= @recent_s
      _other -> false
    end
  end

  @doc "The vehicles with a word for each, those that need somebody first."
  @spec entries(t()) :: [entry()]
  def entries(%{operation: operation} = results) do
    for(
      {id, state} <- operation["vehicles"],
      {kind, word} = badge(state, type(operation), operation["state"], results.done[id]),
      do: %{vehicle: id, kind: kind, word: word, reason: state["reason"]}
    )
    |> Enum.sort_by(&{need(&1.kind), Row.order(&1.vehicle)})
  end

  defp need(kind), do: Enum.find_index(~w(bad warn plain info ok), &(&1 == kind))

  defp type(%{"what" => %{"command" => %{"type" => type}}}), do: type
  defp type(%{"what" => %{"sequence" => steps}}), do: Enum.find(steps, &(&1 == "takeoff"))
  defp type(_other), do: nil

  defp badge(%{"state" => "waiting"}, _type, state, _done) when state in ~w(running paused),
    do: {"plain", "Waiting"}

  defp badge(%{"state" => "waiting"}, _type, _over, _done), do: {"plain", "Not begun"}

  defp badge(%{"state" => "under_way"} = vehicle, _type, _state, _done),
    do: {"info", Map.get(@steps, vehicle["step"], "Under way")}

  defp badge(%{"state" => "failed", "result" => status}, _type, _state, _done) do
    {tone, word} = Entry.result(status)
    {Entry.badge(tone), word}
  end

  defp badge(_ok, "take_control", _state, _done), do: {"ok", "In charge"}
  defp badge(_ok, "release_control", _state, _done), do: {"ok", "Released"}
  defp badge(_ok, "hold", _state, %{ended: :left}), do: {"plain", "No longer holding"}
  defp badge(_ok, "hold", _state, _done), do: {"ok", "Holding"}
  defp badge(_ok, type, _state, %{ended: :landed}) when type in ~w(land rtl), do: {"ok", "Landed"}
  defp badge(_ok, "land", _state, %{ended: :left}), do: {"plain", "No longer landing"}
  defp badge(_ok, "land", _state, _done), do: {"ok", "Landing"}
  defp badge(_ok, "rtl", _state, %{ended: :left}), do: {"plain", "No longer returning"}
  defp badge(_ok, "rtl", _state, _done), do: {"ok", "Returning"}
  defp badge(_ok, "takeoff", _state, _done), do: {"ok", "Up"}
  defp badge(_ok, _sequence, _state, _done), do: {"ok", "Done"}

  @doc "It in one line: `Hold: all 6 holding`, `Land: sim-002 landed`, `Return: 1 not allowed, 5 returning`."
  @spec title(t(), [entry()]) :: String.t()
  def title(%{operation: operation}, entries) do
    name = operation["name"] || "Operation"
    words = for entry <- entries, do: String.downcase(entry.word)

    case {entries, Enum.uniq(words)} do
      {[one], [word]} ->
        "#{name}: #{one.vehicle} #{word}"

      {_all, [word]} ->
        "#{name}: all #{length(words)} #{word}"

      {_all, several} ->
        "#{name}: " <> Enum.map_join(several, ", ", &"#{Enum.count(words, fn w -> w == &1 end)} #{&1}")
    end
  end

  attr :results, :any, required: true

  @doc "The card."
  def card(assigns) do
    entries = entries(assigns.results)
    assigns = assign(assigns, title: title(assigns.results, entries), more: max(length(entries) - @most, 0))
    assigns = assign(assigns, :entries, Enum.take(entries, @most))

    ~H"""
    <section id="fleet-results" class="fleet-batch card" aria-label="Results" data-operation={@results.operation["id"]}>
      <header class="spread">
        <h2>{@title}</h2>
        <.button kind="quiet" icon="x" label="Close" phx-click="close_results" />
      </header>
      <ul aria-live="polite">
        <li :for={entry <- @entries} :key={entry.vehicle}>
          <span>{entry.vehicle}</span>
          <.badge kind={entry.kind}>{entry.word}</.badge>
          <span class="muted">{entry.reason}</span>
        </li>
      </ul>
      <p :if={@more > 0} class="muted">and {@more} more</p>
    </section>
    """
  end
end
