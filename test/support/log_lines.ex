defmodule Aerie.LogLines do
  @moduledoc "The lines of the log as a running gateway writes them, as messages to the test."

  alias Aerie.Base.Log.Formatter

  @doc "Sends `{:line, line}` to the calling process for each event from now on, until the test ends."
  @spec collect(Formatter.format()) :: :ok
  def collect(format \\ :logfmt) do
    id = :"log_lines_#{System.unique_integer([:positive])}"
    {module, config} = Formatter.new(format)

    :ok = :logger.add_handler(id, __MODULE__, %{config: %{to: self(), format: &module.format(&1, config)}})
    ExUnit.Callbacks.on_exit(fn -> :logger.remove_handler(id) end)
  end

  @doc false
  @spec log(:logger.log_event(), map()) :: term()
  def log(event, %{config: %{to: to, format: format}}),
    do: send(to, {:line, IO.iodata_to_binary(format.(event))})
end
