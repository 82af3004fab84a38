defmodule MavRouter.Recorder.Supervisor do
  @moduledoc """
  Owns the recorder's tables (rings included) and supervises what works on them.

  ```
  MavRouter.Recorder.Supervisor    one_for_one, owns the tables; no code of its own that could fail
  ├─ Archive                   the folder: names, index, room
  ├─ dynamic supervisor        a Recording for each vehicle that is recorded, and for each ring that is being saved
  └─ AutoStart                 starts those, saves rings on events
  ```

  A link's `MavRouter.Recorder.Recording` is in the link's own tree. Links and vehicles call none of these: they send messages or write into
  a table.
  """
  use Supervisor

  alias Aerie.Base.Names
  alias MavRouter.Recorder.{Archive, AutoStart, Settings, Tables}

  @max_recordings 1_024

  @doc "Options: `:gateway`, `:settings` (`MavRouter.Recorder.Settings`)."
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(options) do
    Supervisor.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :recorder))
  end

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:recorder, gateway})
    %Settings{} = settings = Keyword.fetch!(options, :settings)
    _tables = Tables.create(gateway, settings)

    children = [
      {Archive, gateway: gateway},
      {DynamicSupervisor,
       name: Names.via(gateway, :recordings), max_children: @max_recordings, max_restarts: 100, max_seconds: 1},
      {AutoStart, gateway: gateway}
    ]

    # A failure of this supervisor restarts what comes after it in the gateway, so only a deliberate killing causes one.
    Supervisor.init(children, strategy: :one_for_one, max_restarts: 100, max_seconds: 1)
  end
end
