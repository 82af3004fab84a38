defmodule Aerie.LinkCase do
  @moduledoc """
  Tests of links and routing: the parts of a gateway that they need, frames to send, and the test process in the place
  of a vehicle's session (`be_session/3`), which gets what the router delivers.
  """
  use ExUnit.CaseTemplate

  alias MavRouter.Link
  alias Aerie.Base.Names

  using do
    quote do
      import Aerie.LinkCase
    end
  end

  @doc """
  Starts store, notices, router and links of a gateway that ends with the test; gives its name. `:before` are further parts,
  before the router, with further options; `:above` are modules after it, `:options` are given to all.
  """
  @spec start_parts(map, keyword) :: reference
  def start_parts(config \\ %{}, more \\ []) do
    gateway = make_ref()
    config = Map.merge(%{clients: []}, config)
    given = Keyword.get(more, :options, [])
    plain = &Enum.map(&1, fn module -> {module, []} end)

    parts =
      plain.([Aerie.Base.Store, Aerie.Base.PubSub]) ++
        Keyword.get(more, :before, []) ++
        plain.(
          [MavRouter.Router.Supervisor] ++
            Keyword.get(more, :above, [MavRouter.Identity.Watchdog]) ++ [Link.Supervisor]
        )

    for {module, further} <- parts do
      options =
        Keyword.merge(
          options(module, gateway, config) ++ [children: [clients(gateway, config)]],
          given ++ further
        )

      start_supervised!(Supervisor.child_spec({module, options}, id: {module, gateway}))
    end

    gateway
  end

  @doc """
  The options with which a part is started: the gateway, and the part's settings from a map with some keys of the
  configuration. A part's settings are those of its folder.
  """
  @spec options(module, term, map) :: keyword
  def options(part, gateway, config) do
    config = without_saving(config)

    case part |> Module.split() |> Enum.drop(-1) |> settings() do
      nil -> [gateway: gateway]
      settings -> [gateway: gateway, settings: settings.from(config)]
    end
  end

  # Those of the part's own folder, or of one above it.
  defp settings([_root]), do: nil

  defp settings(folder) do
    settings = Module.concat(folder ++ ["Settings"])

    if Code.ensure_loaded?(settings) and function_exported?(settings, :from, 1),
      do: settings,
      else: folder |> Enum.drop(-1) |> settings()
  end

  @doc "The specification of the client endpoints, as a gateway gives it to its router."
  @spec clients(term, map) :: Supervisor.child_spec()
  def clients(gateway, config),
    do:
      Aerie.Base.Names.Successor.child_spec(
        {MavRouter.Client.Supervisor, options(MavRouter.Client.Supervisor, gateway, config)}
      )

  # Recordings are saved on events only where a test asks for it.
  defp without_saving(config) do
    recorder = Map.get(config, :recorder, %{})
    ring = Map.put_new(Map.get(recorder, :ring) || %{}, :save_on, [])
    Map.put(config, :recorder, Map.put(recorder, :ring, ring))
  end

  @doc "Makes the calling process the session of a vehicle."
  @spec be_session(term, non_neg_integer, String.t()) :: :ok
  def be_session(gateway, system, network \\ "main") do
    :ok = Names.register(gateway, :session, {network, system})
  end

  @doc """
  Gives `deliver` the heartbeats of 300 vehicles on two networks, each followed by a frame of the calling process's own session, of
  which none may be lost. A few vehicles are started at once, the others by `MavRouter.Router.Starter`. Gives their keys.
  """
  @spec many_vehicles(term, (binary, network :: String.t() -> map)) :: [{String.t(), pos_integer}]
  def many_vehicles(gateway, deliver) do
    be_session(gateway, 250)

    outcomes =
      for n <- 0..299 do
        network = "net #{div(n, 200)}"
        outcome = deliver.(heartbeat(rem(n, 200) + 1), network)
        %{delivered: 1} = deliver.(attitude(250, n), "main")
        outcome
      end

    true = Enum.all?(outcomes, &match?(%{delivered: 1, refused: 0, unclaimed: 0}, &1))
    # Four more for each second that this takes.
    true = Enum.count(outcomes, &(&1.sessions != [])) in 32..200
    for n <- 0..299, do: {"net #{div(n, 200)}", rem(n, 200) + 1}
  end

  @doc "Frames of the calling process's sessions, in order, until there are `n`."
  @spec frames(non_neg_integer, [MavCodec.Frame.t()]) :: [MavCodec.Frame.t()]
  def frames(n, got \\ [])
  def frames(n, got) when length(got) >= n, do: got

  def frames(n, got) do
    receive do
      {:frames, _link, frames} -> frames(n, got ++ frames)
    after
      Aerie.Patience.ms() -> ExUnit.Assertions.flunk("#{length(got)} of #{n} frames came")
    end
  end

  @doc "See `Aerie.Patience.eventually/1`."
  @spec eventually((-> result)) :: result when result: term
  defdelegate eventually(fun), to: Aerie.Patience

  @doc "Adds a link to the gateway; gives its id and, for a server, its port."
  @spec add_link(term, String.t(), keyword) :: {String.t(), non_neg_integer | nil}
  def add_link(gateway, text, options \\ []) do
    {:ok, id} = Link.start(gateway, text, options)
    {id, snapshot(gateway, id).port}
  end

  @doc "The snapshot of this moment, however late the link is: after a second `MavRouter.Link.snapshot/2` gives an older one."
  @spec snapshot(term, String.t()) :: map | nil
  def snapshot(gateway, id), do: Link.snapshot(gateway, id, Aerie.Patience.ms())

  @doc """
  Sends a link something in pieces, each by a function that is given with the piece's size, so that it gets them in these pieces and
  reads all of them at once. A busy machine makes pauses of any length, and after a short silence a link gives up half a frame.
  """
  @spec in_pieces(term, String.t(), [{pos_integer, (-> term)}]) :: :ok
  def in_pieces(gateway, id, pieces) do
    link = Names.whereis(gateway, :link, id)
    :ok = :sys.suspend(link, Aerie.Patience.ms())

    Enum.reduce(pieces, waiting(link), fn {size, send}, before ->
      send.()
      eventually(fn -> waiting(link) >= before + size end)
      before + size
    end)

    :ok = :sys.resume(link, Aerie.Patience.ms())
  end

  # The bytes in a link's mailbox.
  defp waiting(link) do
    {:messages, messages} = Process.info(link, :messages)

    Enum.sum(for m <- messages, is_tuple(m), b = elem(m, tuple_size(m) - 1), is_binary(b), do: byte_size(b))
  end

  @doc "Sends the link's telemetry events to the calling process, as `{event, measurements, metadata}`."
  @spec listen(term, [atom]) :: :ok
  def listen(gateway, events) do
    test = self()
    id = {gateway, events, make_ref()}

    :ok =
      :telemetry.attach_many(
        id,
        for(event <- events, do: [:aerie, :link, event]),
        fn [_, _, event], measurements, metadata, _config ->
          if metadata.gateway == gateway, do: send(test, {event, measurements, metadata})
        end,
        nil
      )

    ExUnit.Callbacks.on_exit(fn -> :telemetry.detach(id) end)
  end

  @doc "Bytes of a heartbeat; an ArduPilot copter's unless `:type` and `:autopilot` say else."
  @spec heartbeat(non_neg_integer, keyword) :: binary
  def heartbeat(system, options \\ []) do
    MavCodec.encode(
      %MavCodec.Messages.Heartbeat{
        type: Keyword.get(options, :type, 2),
        autopilot: Keyword.get(options, :autopilot, 3),
        system_status: 4,
        mavlink_version: 3
      },
      system: system,
      component: Keyword.get(options, :component, 1),
      seq: Keyword.get(options, :seq, 0)
    )
  end

  @doc "Bytes of an ATTITUDE frame that carries `n` as its time."
  @spec attitude(non_neg_integer, non_neg_integer) :: binary
  def attitude(system, n) do
    MavCodec.encode(%MavCodec.Messages.Attitude{time_boot_ms: n, roll: 0.5, yaw: 1.0},
      system: system,
      component: 1,
      seq: rem(n, 256)
    )
  end

  @doc "Telemetry of a large kind, of which few frames fill what buffers there are."
  @spec odometry(non_neg_integer, non_neg_integer) :: binary
  def odometry(system, n) do
    MavCodec.encode(%MavCodec.Messages.Odometry{time_usec: n, quality: 1},
      system: system,
      component: 1,
      seq: rem(n, 256)
    )
  end

  @doc "The number that an `attitude/2` frame carries."
  @spec number(MavCodec.Frame.t()) :: non_neg_integer
  def number(%{payload: <<n::32-little, _::binary>>}), do: n
end
