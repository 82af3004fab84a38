defmodule MavCodec.Generated.Dialects4 do
  use MavCodec.Definition.Shard, dialects: {4, 4}
end
