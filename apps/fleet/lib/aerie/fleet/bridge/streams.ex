defmodule Aerie.Fleet.Bridge.Streams do
  @moduledoc """
  The two JetStream streams of the gateway.

  | stream | subjects | keeps |
  |---|---|---|
  | `FLEET_STATE` | `fleet.*.*.state.>` | the last message of each subject |
  | `FLEET_EVENTS` | `fleet.*.*.event.>` | events, up to an age and a size, the oldest go first |

  At a hub each vehicle's events have a stream of their own in the place of the second one
  (`Aerie.Fleet.Bridge.Events.VehicleStreams`).

  A missing stream is created. A stream that differs from the configuration is changed on the embedded server; one that
  is kept in the wrong place, which cannot be changed, is deleted and made again if it has only last values. On another
  server it is left as it is and the difference is reported, because another gateway or an operator may have set it,
  except for what keeps vehicles from having an effect on each other (`guarded/2`): that is changed everywhere.
  """

  alias Aerie.Fleet.Bridge.{Message, Settings}
  alias Aerie.Fleet.Nats
  alias Aerie.Fleet.Nats.JetStream
  alias Gnat.Jetstream.API.Stream, as: Api

  @compared [
    :subjects,
    :max_msgs_per_subject,
    :max_bytes,
    :max_msg_size,
    :max_age,
    :duplicate_window,
    :num_replicas,
    :allow_direct,
    :discard,
    :retention,
    :storage,
    :allow_rollup_hdrs
  ]
  @state "FLEET_STATE"
  @guarded [:max_msg_size, :duplicate_window, :allow_rollup_hdrs]
  # Name, headers and subject of a message beside its body.
  @beside 1_024

  # insufficient storage resources available, insufficient memory, no resources of the account
  @no_room [10_047, 10_028, 10_023]

  @type report :: %{String.t() => :created | :ok | :updated | {:differs, [String.t()]} | {:error, String.t()}}

  @doc "The streams as configured."
  @spec wanted(Settings.t()) :: [struct()]
  def wanted(%Settings{nats: %{streams: streams}} = settings) do
    # State messages have no ids; with one, they would be dropped as copies of others.
    state = %{
      name: @state,
      storage: Settings.state_storage(settings.nats),
      subjects: ["fleet.*.*.state.>"],
      description: "Last value of each state group of each vehicle",
      max_msgs_per_subject: 1,
      max_msg_size: Message.max_state_bytes() + @beside,
      max_bytes: streams.state_max_mb * 1_048_576,
      max_age: nanoseconds(streams.state_max_age_days),
      duplicate_window: JetStream.no_window(),
      allow_direct: true
    }

    [
      stream(streams, state)
      | if(streams.events_per_vehicle, do: [], else: [events(settings, "FLEET_EVENTS", "*")])
    ]
  end

  @doc """
  When the stream of last values was made; nil if that cannot be learned. If it is a new one, the values in the former
  are gone, and all that are known have to be published.
  """
  @spec state_made_at(Aerie.Fleet.Nats.conn()) :: DateTime.t() | nil
  def state_made_at(conn) do
    case Nats.call(conn, fn -> Api.info(conn, @state) end) do
      {:ok, %{created: at}} -> at
      {:error, _reason} -> nil
    end
  end

  @doc "A stream of the events of a vehicle, `*` for all."
  @spec events(Settings.t(), name :: String.t(), vehicle :: String.t()) :: struct()
  def events(%Settings{nats: %{streams: streams}}, name, vehicle) do
    max_age = nanoseconds(streams.event_max_age_days)

    stream(streams, %{
      name: name,
      subjects: ["fleet.*.#{vehicle}.event.>"],
      description: if(vehicle == "*", do: "Events of vehicles", else: "Events of #{vehicle}"),
      max_bytes: streams.event_max_mb * 1_048_576,
      max_age: max_age,
      duplicate_window: duplicate_window(streams.duplicate_window_s * 1_000_000_000, max_age)
    })
  end

  defp stream(streams, fields) do
    common = %{
      retention: :limits,
      storage: :file,
      discard: :old,
      num_replicas: streams.replicas,
      allow_rollup_hdrs: false
    }

    struct!(Api, Map.merge(common, fields))
  end

  @doc """
  A stream as it is, except for what must be right even if another program made it: roll-up, the size of a message, and
  the window in which the server looks for copies where messages have no ids.
  """
  @spec guarded(there :: struct(), wanted :: struct()) :: struct()
  def guarded(there, wanted) do
    keys =
      if wanted.duplicate_window == JetStream.no_window(), do: @guarded, else: @guarded -- [:duplicate_window]

    struct!(there, for({key, value} <- Map.take(wanted, keys), value != nil, do: {key, value}))
  end

  defp nanoseconds(days), do: round(days * 86_400 * 1_000_000_000)

  # The server refuses a window that is longer than the age limit.
  defp duplicate_window(window, 0), do: window
  defp duplicate_window(window, max_age), do: min(window, max_age)

  @doc "Creates or checks both streams; an error if one of them cannot be used."
  @spec ensure(Aerie.Fleet.Nats.conn(), Settings.t()) :: {:ok, report()} | {:error, report()}
  def ensure(conn, %Settings{} = settings) do
    report = Map.new(wanted(settings), &{&1.name, ensure_one(conn, &1, settings.nats.mode)})
    failed? = Enum.any?(report, &match?({_name, {:error, _}}, &1))
    {if(failed?, do: :error, else: :ok), report}
  end

  defp ensure_one(conn, wanted, mode) do
    case Nats.call(conn, fn -> Api.info(conn, wanted.name) end) do
      {:ok, %{config: there}} -> compare(conn, wanted, there, mode)
      {:error, %{"code" => 404}} -> create(conn, wanted)
      {:error, reason} -> {:error, Nats.text(reason)}
    end
  end

  defp create(conn, wanted) do
    # Unless it is configured, the storage of a stream that is there is right.
    case Nats.call(conn, fn -> Api.create(conn, %{wanted | storage: wanted.storage || :file}) end) do
      {:ok, _info} -> :created
      {:error, reason} -> {:error, not_made(reason, wanted)}
    end
  end

  # The server reserves a stream's size when it creates it.
  defp not_made(%{"err_code" => code} = reason, wanted) when code in @no_room do
    key = if wanted.name == @state, do: "state_max_mb", else: "event_max_mb"
    "#{Nats.text(reason)} for #{div(wanted.max_bytes, 1_048_576)} MB (nats.streams.#{key})"
  end

  defp not_made(reason, _wanted), do: Nats.text(reason)

  # Its values come again.
  defp compare(conn, %{name: @state, storage: storage} = wanted, %{storage: other}, :embedded)
       when storage != nil and storage != other do
    case Nats.call(conn, fn -> Api.delete(conn, @state) end) do
      :ok -> create(conn, wanted)
      {:error, reason} -> {:error, Nats.text(reason)}
    end
  end

  defp compare(conn, wanted, there, mode) do
    case {differences(wanted, there), mode} do
      {[], _mode} -> :ok
      {differences, :embedded} -> update(conn, wanted, differences)
      {differences, :url} -> guard(conn, wanted, there, differences)
    end
  end

  # On another server only what guards vehicles from each other is changed.
  defp guard(conn, wanted, there, differences) do
    guarded = guarded(there, wanted)

    with false <- differences(guarded, there) == [],
         :updated <- update(conn, guarded, differences),
         [_ | _] = others <- differences(wanted, guarded) do
      {:differs, others}
    else
      true -> {:differs, differences}
      [] -> :updated
      differs -> differs
    end
  end

  defp update(conn, wanted, differences) do
    case Nats.call(conn, fn -> Api.update(conn, wanted) end) do
      {:ok, _info} -> :updated
      # Some settings of an existing stream cannot be changed. It works as it is.
      {:error, _reason} -> {:differs, differences}
    end
  end

  @doc "The differences as texts: `max_bytes is 1, configured 2`."
  @spec differences(struct(), struct()) :: [String.t()]
  def differences(wanted, there) do
    for key <- @compared, Map.fetch!(wanted, key) != nil, normal(wanted, key) != normal(there, key) do
      "#{key} is #{there |> Map.get(key) |> format()}, configured #{wanted |> Map.get(key) |> format()}"
    end
  end

  defp normal(stream, key), do: stream |> Map.get(key) |> normal()

  defp normal(list) when is_list(list), do: Enum.sort(list)
  defp normal(0), do: nil
  defp normal(-1), do: nil
  defp normal(false), do: nil
  defp normal(atom) when is_atom(atom) and not is_nil(atom), do: Atom.to_string(atom)
  defp normal(value), do: value

  defp format(list) when is_list(list), do: Enum.join(list, " ")
  defp format(nil), do: "not set"
  defp format(value), do: to_string(value)
end
