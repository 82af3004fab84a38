defmodule Aerie.Patience do
  @moduledoc """
  How long a test waits for what comes at once on an idle machine. It only guards against hanging: nothing is measured by it,
  and a machine that is busy with something else makes no test fail. It stands in `config/config.exs`, for `assert_receive` as
  well.
  """

  @doc "In milliseconds."
  @spec ms() :: pos_integer()
  def ms, do: Application.fetch_env!(:ex_unit, :assert_receive_timeout)

  @doc """
  How many tests run at once in a suite that waits for vehicles and servers more than it computes: more than there are cores, but
  half as many on a machine that is busy with something else, where each would only take longer.
  """
  @spec cases() :: pos_integer()
  def cases do
    cores = System.schedulers_online()
    if load() > 4 * cores, do: 2 * cores, else: 4 * cores
  end

  @doc """
  Loads the code of all applications, as a release does when it boots. Where each module is loaded when it is first called, the
  first frames of a link wait for dozens of them, and beside the compiler of the test files for seconds.
  """
  @spec load_code() :: :ok
  def load_code do
    modules =
      for {app, _description, _version} <- Application.loaded_applications(),
          module <- Application.spec(app, :modules),
          do: module

    # Some that nothing uses cannot be loaded without an application that is not there.
    _ = :code.ensure_modules_loaded(modules)
    :ok
  end

  # Runnable processes in the last minute, where the system tells.
  defp load do
    with {:ok, text} <- File.read("/proc/loadavg"),
         {load, _more} <- Float.parse(text),
         do: load,
         else: (_none -> 0.0)
  end

  @doc "Until then, in the time of `System.monotonic_time(:millisecond)`."
  @spec deadline() :: integer()
  def deadline, do: System.monotonic_time(:millisecond) + ms()

  @doc """
  Polls until `fun` returns something truthy, and returns that: for facts that send no message. `what` says in a failure
  what was awaited: a text, or a function that returns one. It pauses for as long as `fun` took, so polling costs half a
  core at most.
  """
  @spec eventually((-> result), String.t() | (-> String.t()), integer()) :: result when result: term()
  def eventually(fun, what \\ "it came true", deadline \\ deadline()) do
    asked = System.monotonic_time(:millisecond)

    cond do
      result = fun.() ->
        result

      System.monotonic_time(:millisecond) > deadline ->
        ExUnit.Assertions.flunk("never: #{if is_function(what), do: what.(), else: what}")

      true ->
        receive do
        after
          max(5, System.monotonic_time(:millisecond) - asked) -> eventually(fun, what, deadline)
        end
    end
  end
end
