defmodule Gnat.Jetstream.PullConsumer.Server do
  @moduledoc """
  The process of `Gnat.Jetstream.PullConsumer`: connects, requests a batch, handles it, requests the next.

  A subscription is identified by its connection and number. Late messages of a former one are dropped without an
  acknowledgement, so the server delivers them again.
  """

  use GenServer

  alias Gnat.Jetstream
  alias Gnat.Jetstream.API.{Consumer, Util}
  alias Gnat.Jetstream.PullConsumer.Options

  require Logger

  @impl GenServer
  def init({module, arg}) do
    case module.init(arg) do
      {:ok, user, options} ->
        Process.set_label({:gnat_pull_consumer, module})

        state = %{
          module: module,
          user: user,
          options: Options.new!(options),
          failures: 0,
          gnat: nil,
          monitor: nil,
          sid: nil,
          inbox: nil,
          consumer: nil,
          # Whether acknowledgements request the next message (`+NXT`), and whether we wait for such a one.
          next?: false,
          bare: false,
          wanted: 0,
          timer: nil
        }

        {:ok, state, {:continue, :connect}}

      other ->
        other
    end
  end

  @impl GenServer
  def handle_continue(:connect, state), do: connect(state)

  @impl GenServer
  def handle_call(:close, _from, state), do: {:stop, :shutdown, :ok, disconnect(state)}

  @impl GenServer
  def handle_info({:msg, %{gnat: gnat, sid: sid} = message}, %{gnat: gnat, sid: sid} = state) do
    state = heard(state)

    case message[:status] do
      nil -> {:noreply, state |> handle(message) |> next()}
      "100" -> {:noreply, state |> flow_control(message) |> status(message)}
      # Nothing there, or the request has run out: ask again.
      status when status in ["404", "408"] -> {:noreply, state |> status(message) |> pull()}
      # The consumer is gone, has a new leader, or has too many requests: start over after a pause.
      _other -> state |> status(message) |> disconnect() |> failed(message[:description])
    end
  end

  def handle_info(:connect, %{gnat: nil} = state), do: connect(state)

  def handle_info({:DOWN, ref, :process, _pid, _reason}, %{monitor: ref} = state) do
    connect(disconnect(%{state | gnat: nil}))
  end

  # After `+NXT` no heartbeats come, so silence means nothing: request as at the start. The inbox is new, because the server
  # drops requests whose inbox has no subscriber, and would keep this one for ever.
  def handle_info({:silent, id}, %{timer: {id, _ref}, bare: true} = state) do
    _ = Gnat.unsub(state.gnat, state.sid)
    inbox = Util.reply_inbox(state.options.inbox_prefix)

    case Gnat.sub(state.gnat, self(), inbox) do
      {:ok, sid} -> {:noreply, pull(%{state | sid: sid, inbox: inbox})}
      {:error, reason} -> state |> disconnect() |> failed(reason)
    end
  end

  def handle_info({:silent, id}, %{timer: {id, _ref}, options: options} = state) do
    :telemetry.execute(
      [:gnat, :jetstream, :pull_consumer, :heartbeat_expired],
      %{threshold_ms: silence(options)},
      %{
        module: state.module,
        stream_name: options.stream_name,
        consumer_name: state.consumer,
        connection_name: options.connection_name
      }
    )

    connect(disconnect(state))
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp connect(%{options: options} = state) do
    with gnat when is_pid(gnat) <- GenServer.whereis(options.connection_name),
         {:ok, info} <- consumer(gnat, options),
         inbox = Util.reply_inbox(options.inbox_prefix),
         {:ok, sid} <- Gnat.sub(gnat, self(), inbox) do
      state = %{
        state
        | gnat: gnat,
          monitor: Process.monitor(gnat),
          sid: sid,
          inbox: inbox,
          consumer: info.name,
          next?: options.batch_size == 1 and info.config.ack_policy != :none
      }

      {:noreply, %{state | failures: 0} |> connected(info) |> pull()}
    else
      nil -> failed(state, "no connection")
      {:error, reason} -> failed(state, reason)
    end
  end

  # A durable consumer must exist; any other is created.
  defp consumer(gnat, %{consumer: nil} = options) do
    Consumer.info(gnat, options.stream_name, options.consumer_name, options.domain)
  end

  defp consumer(gnat, %{consumer: consumer, domain: domain}),
    do: Consumer.create(gnat, %{consumer | domain: domain})

  defp failed(%{failures: failures, options: %{connection_retries: retries} = options} = state, reason) do
    if failures >= retries do
      text = if is_exception(reason), do: Exception.message(reason), else: inspect(reason)
      Logger.error("#{inspect(state.module)} gives up consuming #{options.stream_name}: #{text}")
      {:stop, :timeout, state}
    else
      Process.send_after(self(), :connect, options.connection_retry_timeout)
      {:noreply, %{state | failures: failures + 1}}
    end
  end

  defp disconnect(state) do
    if state.monitor, do: Process.demonitor(state.monitor, [:flush])
    # If the subscription cannot be ended, its connection is lost.
    _ = if state.gnat, do: Gnat.unsub(state.gnat, state.sid)
    %{cancel(state) | gnat: nil, monitor: nil, sid: nil, wanted: 0}
  end

  defp handle(state, message) do
    case state.module.handle_message(message, state.user) do
      {:ack, user} when state.next? ->
        _ = Jetstream.ack_next(message, state.inbox)
        heard(%{state | user: user, wanted: 1, bare: true})

      {action, user} ->
        _ = acknowledge(action, message)
        %{state | user: user, wanted: state.wanted - 1}
    end
  end

  # If the acknowledgement is lost with the connection, the server delivers the message again.
  defp acknowledge(:ack, message), do: Jetstream.ack(message)
  defp acknowledge(:nack, message), do: Jetstream.nack(message)
  defp acknowledge(:term, message), do: Jetstream.ack_term(message)
  defp acknowledge(:noreply, _message), do: :ok

  defp next(%{wanted: wanted} = state) when wanted > 0, do: state
  defp next(state), do: pull(state)

  # If this fails, the connection is lost, which the monitor reports.
  defp pull(%{options: options} = state) do
    request = [
      batch: options.batch_size,
      expires: options.request_expires,
      idle_heartbeat: options.idle_heartbeat
    ]

    _ =
      Consumer.request_next_message(
        state.gnat,
        options.stream_name,
        state.consumer,
        state.inbox,
        options.domain,
        request
      )

    heard(%{state | wanted: options.batch_size, bare: false})
  end

  defp flow_control(state, %{reply_to: reply_to}) when is_binary(reply_to) do
    _ = Gnat.pub(state.gnat, reply_to, "")
    state
  end

  defp flow_control(state, _message), do: state

  defp connected(state, info), do: callback(state, :handle_connected, info)
  defp status(state, message), do: callback(state, :handle_status, message)

  defp callback(%{module: module} = state, name, argument) do
    if function_exported?(module, name, 2) do
      {:ok, user} = apply(module, name, [argument, state.user])
      %{state | user: user}
    else
      state
    end
  end

  # Each timer has its own number, so that one that fires while it is cancelled is not mistaken for the next.
  defp heard(state) do
    id = make_ref()
    %{cancel(state) | timer: {id, Process.send_after(self(), {:silent, id}, silence(state.options))}}
  end

  defp cancel(%{timer: nil} = state), do: state

  defp cancel(%{timer: {_id, ref}} = state) do
    _ = Process.cancel_timer(ref)
    %{state | timer: nil}
  end

  # Two heartbeats, in ms.
  defp silence(%{idle_heartbeat: ns}), do: max(div(ns * 2, 1_000_000), 1)
end
