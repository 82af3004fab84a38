defmodule Aerie.CLI.Start.ModuleLoader do
  @moduledoc """
  Loads all modules of the gateway and its dependencies after the start. The BEAM otherwise reads a module's file at the
  first call, which fails when file descriptors have run out or the files are gone.

  Loading takes a second or two, and links and vehicles do not wait for it. But frames that come meanwhile are late, so the gateway
  says that it is ready only when all is loaded (`Aerie.Base.Store.starting/2`). Modules are loaded in small batches: a large one would
  delay modules that are needed at once, and one by one takes twice the time.
  """

  require Logger

  alias Aerie.Base.{Names, Store}

  @batch 32

  @doc false
  # As a part of a run, so that the gateway is not said to be ready by a part after it.
  @spec start(Names.gateway()) :: :ignore
  def start(gateway) do
    _pid = load(gateway)
    :ignore
  end

  # Starts loading. Returns the pid of the loading process, which ends when all modules are loaded.
  defp load(gateway) do
    {:ok, pid} =
      Task.start(fn ->
        Process.set_label(:module_loader)
        failed = all() |> Enum.chunk_every(@batch) |> Enum.flat_map(&batch/1)
        if failed != [], do: Logger.warning("some modules cannot be loaded: #{inspect(failed)}")
      end)

    :ok = Store.starting(gateway, pid)
    pid
  end

  @doc "Loads them before a start, and waits for it."
  @spec load_now() :: :ok
  def load_now do
    _ = :code.ensure_modules_loaded(all())
    :ok
  end

  defp batch(modules) do
    case :code.ensure_modules_loaded(modules) do
      :ok -> []
      {:error, failed} -> failed
    end
  end

  @doc "The modules of the gateway's applications and of their dependencies; Aerie's own come first."
  @spec all() :: [module()]
  def all do
    # Nothing starts it; a release does not have it.
    _ = Application.load(:sim_vehicle)
    apps = applications([:aerie, :sim_vehicle], [])
    for app <- apps, module <- Application.spec(app, :modules) || [], do: module
  end

  defp applications([], known), do: Enum.reverse(known)

  defp applications([app | rest], known) do
    if app in known,
      do: applications(rest, known),
      else: applications(rest ++ (Application.spec(app, :applications) || []), [app | known])
  end
end
