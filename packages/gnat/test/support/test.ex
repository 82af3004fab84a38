defmodule Gnat.Test do
  @moduledoc "Helpers of the tests."

  @doc "Polls until a condition is true, for facts that send no message; the limit only guards against hanging."
  def eventually(check, deadline \\ System.monotonic_time(:millisecond) + 60_000) do
    cond do
      result = check.() ->
        result

      System.monotonic_time(:millisecond) > deadline ->
        raise ExUnit.AssertionError, message: "did not become true"

      true ->
        receive do
        after
          5 -> eventually(check, deadline)
        end
    end
  end

  @doc "Publishes into a stream, and waits until it has the message; gives the server's answer."
  def store(gnat, topic, body, headers \\ []),
    do: Gnat.Jetstream.API.Util.request(gnat, topic, body, headers: headers)

  @doc "A unique name for subjects and streams."
  def unique(prefix), do: "#{prefix}_#{System.unique_integer([:positive])}"

  @doc "Sends telemetry events of this name to the test as `{:telemetry, event, measurements, metadata}`."
  def telemetry(event, test \\ self()) do
    id = {__MODULE__, make_ref()}
    :ok = :telemetry.attach(id, event, &__MODULE__.forward/4, test)
    ExUnit.Callbacks.on_exit(fn -> :telemetry.detach(id) end)
  end

  def forward(event, measurements, metadata, pid), do: send(pid, {:telemetry, event, measurements, metadata})
end
