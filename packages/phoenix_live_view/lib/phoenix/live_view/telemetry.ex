defmodule Phoenix.LiveView.Telemetry do
  @moduledoc """
  The events that this package emits with `:telemetry`. Their names, measurements and metadata are a contract.

  Spans, as in the namesake: `[:phoenix, :live_view, callback, :start | :stop | :exception]` for the callbacks `:mount`,
  `:handle_params`, `:handle_event` and `:render`. Measurements: `system_time` at the start, `duration` (native units) at the end.
  Metadata: `socket`; `params`, `uri` and `event` where the callback has them; `kind`, `reason` and `stacktrace` of an exception.

  Single events, which the namesake does not have:

  | event | measurements | metadata |
  |---|---|---|
  | `[:phoenix, :live_view, :refused]` | `count: 1` | `what`: `:socket`, `:frame` or `:event`; `reason`, text for people |
  | `[:phoenix, :live_view, :slow]` | `count: 1` | `view`, which ended because its browser did not read |
  """

  alias Phoenix.LiveView.Socket

  @doc "All events."
  @spec events() :: [[atom()]]
  def events do
    spans =
      for callback <- [:mount, :handle_params, :handle_event, :render],
          point <- [:start, :stop, :exception],
          do: [:phoenix, :live_view, callback, point]

    spans ++ [[:phoenix, :live_view, :refused], [:phoenix, :live_view, :slow]]
  end

  @doc false
  @spec span(atom(), Socket.t(), map(), (-> result)) :: result when result: term()
  def span(callback, socket, metadata, fun) do
    metadata = Map.put(metadata, :socket, socket)

    :telemetry.span([:phoenix, :live_view, callback], metadata, fn ->
      result = fun.()
      {result, metadata}
    end)
  end

  @doc false
  @spec refused(:socket | :frame | :event, String.t()) :: :ok
  def refused(what, reason),
    do: :telemetry.execute([:phoenix, :live_view, :refused], %{count: 1}, %{what: what, reason: reason})

  @doc false
  @spec slow(module()) :: :ok
  def slow(view), do: :telemetry.execute([:phoenix, :live_view, :slow], %{count: 1}, %{view: view})
end
