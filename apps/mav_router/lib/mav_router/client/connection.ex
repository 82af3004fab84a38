defmodule MavRouter.Client.Connection do
  @moduledoc """
  One client's connection to the router: its bytes are delivered as frames, and frames for it wait here until they can be written. A
  value, for the process that has the client's socket and is the endpoint.

      {:ok, pipe} = Connection.open(gateway, id: "ws-1", kind: :websocket, text: "10.0.0.9:51234")
      pipe = Connection.read(pipe, bytes)
      receive do: ({:forward, frames, class} -> pipe = Connection.queue(pipe, frames, class))
      {frames, pipe} = Connection.take(pipe)

  Data that the client requested has room of its own (`MavRouter.Endpoints.Queue.RequestedData`). When the client does
  not read, the oldest other frames of the least important class are dropped (`MavRouter.Endpoints.Queue.ClassQueue`).
  Each connection is a pipe of its own, so no frame of an earlier one waits for it.
  """

  alias Aerie.Base.Names
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Client.LocalEndpoint
  alias MavRouter.Endpoints.Queue.ClassQueue
  alias MavCodec.Parser

  # Bytes of frames that are written at a time.
  @chunk 16_384

  @enforce_keys [:endpoint, :parser, :queue]
  defstruct [:endpoint, :parser, :queue, :cache]

  @type t :: %__MODULE__{
          endpoint: Endpoint.t(),
          parser: Parser.t(),
          queue: ClassQueue.t(),
          cache: MavRouter.Router.cache() | nil
        }

  @doc """
  Makes the calling process a client endpoint. Options are those of `MavRouter.Client.LocalEndpoint.attach/2`; without
  `:networks` it sees all, the gateway's own first.
  """
  @spec open(Names.gateway(), keyword()) :: {:ok, t()} | {:error, String.t() | :not_running}
  def open(gateway, options) do
    with {:ok, endpoint} <- LocalEndpoint.attach(gateway, options) do
      {:ok, %__MODULE__{endpoint: endpoint, parser: Parser.new(), queue: ClassQueue.new()}}
    end
  end

  @doc "Delivers bytes that the client sent now: whole frames, one or several."
  @spec read(t(), binary()) :: t()
  def read(pipe, bytes) do
    {frames, parser} = Parser.push_datagram(pipe.parser, bytes, System.os_time(:microsecond))
    {requests?, queue} = ClassQueue.request(pipe.queue, frames, now())
    _room = if requests?, do: Endpoint.requested(pipe.endpoint, now())
    {_outcome, cache} = LocalEndpoint.ingress(pipe.endpoint, frames, pipe.cache)
    %{pipe | parser: parser, queue: queue, cache: cache}
  end

  @doc "Frames for the client; call it for every `{:forward, frames, class}` message."
  @spec queue(t(), [binary()], MavRouter.Endpoints.Queue.TrafficClass.class()) :: t()
  def queue(pipe, frames, class) do
    Endpoint.taken(pipe.endpoint, length(frames))
    {queue, dropped} = ClassQueue.push(pipe.queue, class, frames, now())
    Endpoint.dropped(pipe.endpoint, dropped)
    if queue.requested.frames > 0, do: Endpoint.requested(pipe.endpoint, now())
    %{pipe | queue: queue}
  end

  @doc "The frames to be written next, the most important first, at most #{div(@chunk, 1024)} KiB; `[]` when none wait."
  @spec take(t()) :: {[binary()], t()}
  def take(pipe), do: take(pipe, now(), [], 0)

  defp take(pipe, now, frames, size) when size < @chunk do
    case ClassQueue.pop(pipe.queue, now) do
      nil -> {Enum.reverse(frames), pipe}
      {{_class, frame}, queue} -> take(%{pipe | queue: queue}, now, [frame | frames], size + byte_size(frame))
    end
  end

  defp take(pipe, _now, frames, _size), do: {Enum.reverse(frames), pipe}

  defp now, do: System.monotonic_time(:millisecond)

  @doc "Whether frames wait."
  @spec waiting?(t()) :: boolean()
  def waiting?(%__MODULE__{queue: %ClassQueue{frames: n}}), do: n > 0
end
