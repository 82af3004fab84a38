defmodule Aerie.Recorder.Supervisor do
  @moduledoc """
  Owns the recorder's tables (rings included) and supervises what works on them.

  ```
  Aerie.Recorder.Supervisor    one_for_one, owns the tables; no code of its own that could fail
  ├─ Archive                   the folder: names, index, room
  ├─ dynamic supervisor        a Recording for each vehicle that is recorded, and for each ring that is being saved
  └─ Watch                     starts those, saves rings on events
  ```

  A link's `Aerie.Recorder.Recording` is in the link's own tree. Nothing here is called by a link or a vehicle: they send, or
  write into a table.
  """
  use Supervisor

  alias Aerie.Names
  alias Aerie.Recorder.{Archive, Settings, Tables, Watch}

  @max_recordings 1_024

  @doc "Options: `:gateway`, `:config`."
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(options) do
    Supervisor.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :recorder))
  end

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:recorder, gateway})
    _tables = Tables.create(gateway, Settings.new(Keyword.get(options, :config)))

    children = [
      {Archive, gateway: gateway},
      {DynamicSupervisor,
       name: Names.via(gateway, :recordings), max_children: @max_recordings, max_restarts: 100, max_seconds: 1},
      {Watch, gateway: gateway}
    ]

    # Whoever comes after in the gateway would be restarted with this one: only a deliberate killing reaches that.
    Supervisor.init(children, strategy: :one_for_one, max_restarts: 100, max_seconds: 1)
  end
end
