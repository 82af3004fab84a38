defmodule Aerie.Upgrade.Standby do
  @moduledoc """
  The waiting of a gateway that takes the place of a running one. It has loaded its code and found that it can use the configuration and
  the data before the other one ends, so that vehicles miss a gateway for no longer than links and NATS take to open.

  They tell each other by files in a folder that the running one has made, for their user only:

  | file | written by | means |
  |---|---|---|
  | `ready` | the waiting one | it can start; its process id |
  | `failed` | the waiting one | it cannot, and why; it has ended |
  | `go` | the running one | it ends, and the waiting one starts when it has |

  A gateway that is not called within a minute ends, because the program that upgrades is gone.
  """

  alias Aerie.Base.Files.Private
  alias Aerie.Base.Net.PortOwner

  @folder "AERIE_STANDBY"
  @replaces "AERIE_REPLACES"
  @tick_ms 5
  @called_ms 60_000
  # Longer than systemd lets a gateway write what it has to.
  @ended_ms 180_000

  @doc "The environment of a gateway that takes the place of process `pid`."
  @spec environment(Path.t(), pid :: String.t()) :: [{String.t(), String.t()}]
  def environment(folder, pid), do: [{@folder, folder}, {@replaces, pid}]

  @doc """
  Waits, if the environment says that this gateway takes the place of another one. `prepare` does all that can be done before, and gives what
  is wrong; it gets what says which ports the other one has.
  """
  @spec wait(%{String.t() => String.t()}, (Aerie.Config.Preflight.ours() -> :ok | {:error, [String.t()]})) ::
          :ok | {:error, [String.t()]}
  def wait(%{@folder => folder, @replaces => pid}, prepare) do
    # Programs that this gateway starts take nobody's place.
    Enum.each([@folder, @replaces], &System.delete_env/1)

    with {former, ""} when former > 0 <- Integer.parse(pid),
         :ok <- prepare.(&PortOwner.holds_port?(&1, &2, former)) do
      :ok = Private.write(Path.join(folder, "ready"), System.pid())

      taken =
        await(fn -> File.exists?(Path.join(folder, "go")) end, @called_ms) and
          await(fn -> not File.exists?("/proc/#{former}") end, @ended_ms)

      _ = File.rm_rf(folder)
      if taken, do: :ok, else: {:error, ["process #{former} goes on, so this gateway does not start"]}
    else
      {:error, messages} ->
        _ = Private.write(Path.join(folder, "failed"), messages)
        {:error, messages}

      _no_process ->
        {:error, ["#{@replaces}: expected a process id, got #{inspect(pid)}"]}
    end
  end

  def wait(_environment, _prepare), do: :ok

  defp await(_true?, left) when left <= 0, do: false

  defp await(true?, left) do
    true?.() or
      receive do
      after
        @tick_ms -> await(true?, left - @tick_ms)
      end
  end
end
