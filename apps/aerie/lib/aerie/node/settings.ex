defmodule Aerie.Node.Settings do
  @moduledoc "The way in for `bin/aerie`."
  use Aerie.Base.Settings

  section("shell", "The way in for bin/aerie and its shell (docs/operating.md).")

  setting(
    :enabled,
    :boolean,
    """
    Let bin/aerie in: status, commands, the shell. It lets in only users who can read the files in dir, and only on this
    machine. They may do everything that the gateway may.
    """,
    default: true
  )

  setting(:dir, :path, "Folder of the cookie and of a file for each running gateway, for its owner only.",
    default: "var/shell"
  )
end
