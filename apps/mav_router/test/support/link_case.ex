defmodule Aerie.LinkCase do
  @moduledoc """
  Tests of links and routing: the parts of a gateway that they need, frames to send, and the test process in the place
  of a vehicle's session (`be_session/3`), which gets what the router delivers.
  """
  use ExUnit.CaseTemplate

  alias Aerie.Link
  alias Aerie.Names

  # For machines that are busy with something else.

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
    given = Keyword.get(more, :options, [])
    options = Keyword.merge([gateway: gateway, config: config, children: [Link.Clients.Supervisor]], given)

    plain = &Enum.map(&1, fn module -> {module, []} end)

    parts =
      plain.([Aerie.Store, Aerie.Store.PubSub]) ++
        Keyword.get(more, :before, []) ++
        plain.(
          [Aerie.Router.Supervisor] ++ Keyword.get(more, :above, [Aerie.Identity.Pulse]) ++ [Link.Supervisor]
        )

    for {module, further} <- parts do
      start_supervised!(Supervisor.child_spec({module, options ++ further}, id: {module, gateway}))
    end

    gateway
  end

  @doc "Makes the calling process the session of a vehicle."
  @spec be_session(term, non_neg_integer, String.t()) :: :ok
  def be_session(gateway, system, network \\ "main") do
    :ok = Names.register(gateway, :session, {network, system})
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
    {id, Link.snapshot(gateway, id).port}
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
