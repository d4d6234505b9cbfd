"""Models of what a camera is asked and what it answers."""

from veilcam_client.wire.base import Nothing as Nothing
from veilcam_client.wire.bundles import (
    BundleInfo as BundleInfo,
    CardFinding as CardFinding,
    CardSummary as CardSummary,
    InstalledBundle as InstalledBundle,
    InstalledBundles as InstalledBundles,
    MaskHiding as MaskHiding,
)
from veilcam_client.wire.calibration import (
    CalibrationRecord as CalibrationRecord,
    CalibrationRun as CalibrationRun,
    CalibrationStatus as CalibrationStatus,
    Quantity as Quantity,
    SceneName as SceneName,
    SignedCalibration as SignedCalibration,
)
from veilcam_client.wire.captures import (
    Capture as Capture,
    Classification as Classification,
    Embedding as Embedding,
    Exposure as Exposure,
    Notes as Notes,
    Prediction as Prediction,
    Replay as Replay,
    SealedEmbedding as SealedEmbedding,
    Timing as Timing,
)
from veilcam_client.wire.lease import (
    Lease as Lease,
    NewLease as NewLease,
)
from veilcam_client.wire.log import (
    LogRecord as LogRecord,
    LogRecords as LogRecords,
)
from veilcam_client.wire.pairing import (
    Paired as Paired,
    PairingOffer as PairingOffer,
)
from veilcam_client.wire.rotation import (
    EveryCaptures as EveryCaptures,
    EverySeconds as EverySeconds,
    Preparation as Preparation,
    Rotation as Rotation,
    RotationOff as RotationOff,
    RotationPolicy as RotationPolicy,
)
from veilcam_client.wire.sealing import (
    Envelope as Envelope,
    PairedReceiver as PairedReceiver,
    Receivers as Receivers,
    SealedKey as SealedKey,
)
from veilcam_client.wire.simulation import (
    Faults as Faults,
    HeldScene as HeldScene,
    LightFaults as LightFaults,
    PanelFaults as PanelFaults,
    SensorFaults as SensorFaults,
)
from veilcam_client.wire.status import (
    Device as Device,
    Diagnostics as Diagnostics,
    PastFault as PastFault,
    PastState as PastState,
    Queue as Queue,
    Remedy as Remedy,
    State as State,
    Status as Status,
    WallClock as WallClock,
)
from veilcam_client.wire.tokens import (
    NewToken as NewToken,
    Role as Role,
    Scope as Scope,
    Token as Token,
    Tokens as Tokens,
)
from veilcam_client.wire.watch import (
    Activity as Activity,
    Belief as Belief,
    OnRequest as OnRequest,
    QuietHours as QuietHours,
    Sighting as Sighting,
    Watch as Watch,
    Watching as Watching,
    WatchOff as WatchOff,
    WatchPolicy as WatchPolicy,
)
