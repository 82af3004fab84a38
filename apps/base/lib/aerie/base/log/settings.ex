defmodule Aerie.Base.Log.Settings do
  @moduledoc "How the log is written, and from which level on."
  use Aerie.Base.Settings

  section "log", "The log, on standard output. Its level can be changed at run time (GET and PATCH /api/log)."

  setting :level,
          {:enum, [:debug, :info, :notice, :warning, :error, :none]},
          "From which level on.",
          default: :info

  setting :format, {:enum, [:logfmt, :json]}, "Lines of key=value pairs, or one JSON object a line.",
    default: :logfmt
end
