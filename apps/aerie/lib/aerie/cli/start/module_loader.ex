defmodule Aerie.CLI.Start.ModuleLoader do
  @moduledoc """
  Loads the modules that a flight uses before the gateway says that it is ready (`Aerie.Base.Store.starting/2`): frames
  that come while code is loaded are late. The other two thirds stay as they are in memory
  (`Aerie.CLI.Start.CodeArchive`), because the BEAM otherwise reads a module's file at the first call, which fails when
  file descriptors have run out or the files are gone. Without an archive all are loaded.

  What a flight uses stands in `priv/flight_modules.txt`; `test/system/flight_modules_test.exs` flies to make it.
  Modules are loaded in small batches: a large one would delay modules that are needed at once, and one by one takes
  twice the time.
  """

  require Logger

  alias Aerie.Base.{Names, Store}
  alias Aerie.CLI.Start.CodeArchive

  @batch 32
  # No running gateway compiles, and no release simulates.
  @unused [:compiler, :xmerl, :tools, :syntax_tools, :sim_vehicle]

  @doc false
  # As a part of a run, so that the gateway is not said to be ready by a part after it.
  @spec start(Names.gateway()) :: :ignore
  def start(gateway) do
    {:ok, pid} =
      Task.start(fn ->
        Process.set_label(:module_loader)

        failed =
          batches(flight()) ++ if(CodeArchive.open(CodeArchive.path()) == :none, do: batches(all()), else: [])

        if failed != [], do: Logger.warning("some modules cannot be loaded: #{inspect(failed)}")

        # A start leaves 10 MB of garbage, most of it in processes that sleep from now on.
        Enum.each(Process.list(), &:erlang.garbage_collect/1)
      end)

    :ok = Store.starting(gateway, pid)
    :ignore
  end

  @doc "Loads them before a start, and waits for it."
  @spec load_now() :: :ok
  def load_now do
    _ = :code.ensure_modules_loaded(if(File.exists?(CodeArchive.path()), do: flight(), else: all()))
    :ok
  end

  @doc "Makes the archive; see `Aerie.CLI.Start.CodeArchive.pack/3`."
  @spec pack(Path.t(), Path.t()) :: :ok
  def pack(path, consolidated), do: CodeArchive.pack(path, all(@unused) -- flight(), consolidated)

  defp batches(modules), do: modules |> Enum.chunk_every(@batch) |> Enum.flat_map(&batch/1)

  defp batch(modules) do
    case :code.ensure_modules_loaded(modules) do
      :ok -> []
      {:error, failed} -> failed
    end
  end

  @doc "The modules that a flight uses."
  @spec flight() :: [module()]
  def flight do
    names =
      :aerie
      |> Application.app_dir("priv/flight_modules.txt")
      |> File.read!()
      |> String.split()
      |> MapSet.new()

    Enum.filter(all(), &(Atom.to_string(&1) in names))
  end

  @doc "The modules of the gateway's applications and of their dependencies, other than those; Aerie's own come first."
  @spec all([atom()]) :: [module()]
  def all(without \\ []) do
    # Nothing starts it; a release does not have it.
    _ = Application.load(:sim_vehicle)
    apps = applications([:aerie, :sim_vehicle], []) -- without
    for app <- apps, module <- Application.spec(app, :modules) || [], do: module
  end

  defp applications([], known), do: Enum.reverse(known)

  defp applications([app | rest], known) do
    if app in known,
      do: applications(rest, known),
      else: applications(rest ++ (Application.spec(app, :applications) || []), [app | known])
  end
end
