defmodule Aerie.Bench.Config do
  @moduledoc "The configuration of a whole gateway for benchmarks: no clients, no local UDP port, and all files below one folder."

  @doc "The configuration with `more` keys."
  @spec new(Path.t(), [{String.t(), term()}]) :: Aerie.Config.t()
  def new(folder, more) do
    dir = &Path.join(folder, &1)

    Aerie.Config.default(
      [
        {"mavlink.local_addr", "off"},
        {"mavlink.system_id", 245},
        {"clients", []},
        {"outbox.dir", dir.("outbox")},
        {"recorder.dir", dir.("recordings")},
        {"signing.dir", dir.("signing")},
        {"policy.audit.dir", dir.("audit")},
        {"commands.ledger.dir", dir.("ledger")},
        {"params.dir", dir.("params")},
        {"shadow.dir", dir.("shadow")},
        {"sockets.dir", dir.("sockets")}
      ] ++ more
    )
  end
end
