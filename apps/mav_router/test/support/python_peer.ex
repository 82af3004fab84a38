defmodule Aerie.PythonPeer do
  @moduledoc """
  Runs a script of `test/peers` in the private Python environment (`AERIE_VENV`, else `.venv` of the checkout). What it
  prints comes to the calling process; it ends with the test.
  """

  @peers Path.expand("../peers", __DIR__)
  @venv Path.expand("../../../../.venv", __DIR__)
  # For what is only slow on a busy machine.

  @doc "The interpreter, nil when there is none."
  @spec python() :: Path.t() | nil
  def python do
    path = Path.join(System.get_env("AERIE_VENV", @venv), "bin/python")
    if File.exists?(path), do: path
  end

  @doc "Starts a script, of that folder or by its whole path; `options` are those of the port, by default lines."
  @spec start(String.t(), [String.t()], list) :: port
  def start(script, arguments, options \\ [line: 1000]) do
    arguments = [Path.expand(script, @peers) | arguments]
    port = Port.open({:spawn_executable, python()}, [:binary, :exit_status, args: arguments] ++ options)
    ExUnit.Callbacks.on_exit(fn -> stop(port) end)
    port
  end

  @doc "Ends a script: its standard input ends."
  @spec stop(port) :: true
  def stop(port) do
    Port.close(port)
  rescue
    ArgumentError -> true
  end

  @doc "Waits for a line that begins so; gives the rest of it."
  @spec await(port, String.t()) :: String.t()
  def await(port, prefix) do
    receive do
      {^port, {:data, {:eol, ^prefix <> rest}}} -> rest
      {^port, {:exit_status, status}} -> ExUnit.Assertions.flunk("the peer ended with status #{status}")
    after
      Aerie.Patience.ms() -> ExUnit.Assertions.flunk("the peer did not say #{inspect(prefix)}")
    end
  end
end
